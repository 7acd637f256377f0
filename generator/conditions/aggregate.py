def points_of_track(scene, track, window=None):
    raise NotImplementedError
