"""MonoSLAM (thesis 2.1 and appendix C): an extended Kalman filter over one camera and the points it looks at."""
