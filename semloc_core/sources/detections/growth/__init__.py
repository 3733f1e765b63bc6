"""A scene graph that grows as a robot looks around: places, objects, and what was said of them."""
