"""Where frames come from: devices, files, streams, and a simulated room; and calibration files."""
