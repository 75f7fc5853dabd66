"""Force and moment that the equations lack, learned from flights and put into the equations."""
