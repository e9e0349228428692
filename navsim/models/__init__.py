"""What the world does: approach, kinematics, IMU, sky, pseudolites, pseudoranges, interference."""
