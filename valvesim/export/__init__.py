"""The valve in other programs: its equations as C, alone and as an FMU; and other people's FMUs as a valve here."""
