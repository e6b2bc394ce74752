"""What is built: places, the grab, the jib head, and the MuJoCo model of them."""
