"""Kernels: the CasADi functions of a component that the C of its FMU calls, and that C."""
