"""What the API sends and takes, one file per resource: the models, and how they are made of the station's values."""
