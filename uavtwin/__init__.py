"""uavtwin: a hybrid digital twin of a multirotor UAV."""
