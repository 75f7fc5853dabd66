"""`uavtwin demo`: a hidden effect found, named, added and shown."""
