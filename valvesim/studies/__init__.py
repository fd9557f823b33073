"""Studies of many valves: what varies, runs in blocks on any number of processes, yield and sensitivities."""
