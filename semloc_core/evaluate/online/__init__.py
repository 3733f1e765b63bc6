"""Online: a robot has walked a few metres and knows a fragment; in which building, and where in it, it is."""
