"""Numbers of aircraft that controllers fly through disturbances, without any excitation."""
