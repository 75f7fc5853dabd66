"""Learned force and moment: laws fitted to flights, selected and evaluated through exported
FMUs."""
