"""How work is done, whatever it is: compiled code, threads and processes, files written whole, ends that come early."""
