"""Keys of LeRobot's batches that this policy reads."""

STATE = "observation.state"
IMAGES = "observation.images."
# Environments with one camera name it so.
IMAGE = "observation.image"
