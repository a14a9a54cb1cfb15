"""The rotating arm: GRBL protocol, serial line, driver, and a simulated controller."""
