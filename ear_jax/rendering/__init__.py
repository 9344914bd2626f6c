"""Pictures of the robot: films, stop-motion strips and the page of `ear explore`."""
