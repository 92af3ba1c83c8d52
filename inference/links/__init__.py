"""Links to the vehicle: sockets and serial ports, what is heard on them, and where it is."""
