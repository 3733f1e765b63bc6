"""How the robot stands beside a place of the map: a heading voted for, a pose made to fit and scored."""
