"""Problems in scene files: the part [plan], how it is read and written."""
