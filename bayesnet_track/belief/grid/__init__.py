"""The grid belief: the General Distribution Filter over cells."""
