"""Pictures of the robot: films, strips and the page to explore."""
