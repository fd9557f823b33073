"""valvesim: a two-stage electro-hydraulic servo valve over temperature and time."""
