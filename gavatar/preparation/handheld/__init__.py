"""A camera that is held by hand: the room's motion in the picture says how it turns and zooms."""
