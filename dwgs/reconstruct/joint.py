"""Scene -> street and traffic together: every pixel of every frame is explained, nothing is masked."""

import time
from collections.abc import Generator
from dataclasses import asdict, replace
from typing import Any

from dwgs.optimize import Checkpoint, Evaluated, Event
from dwgs.reconstruct.config import ReconstructConfig
from dwgs.reconstruct.fit import learn, prepare, summary
from dwgs.reconstruct.model import Street
from dwgs.reconstruct.movers import find_movers, hits_on_movers, unmask
from dwgs.reconstruct.reconstruction import Reconstruction, evaluate_whole
from dwgs.reconstruct.traffic import Traffic
from dwgs.scene import Insertion, Scene

INSERTED = "inserted"
"""Id of the vehicle that a generator put in."""


def reconstruct_jointly(
    scene: Scene,
    config: ReconstructConfig | None = None,
    insertion: Insertion | None = None,
    checkpoint: Checkpoint | None = None,
) -> Generator[Event, None, tuple[Reconstruction, dict[str, Any]]]:
    """Fit the street, its sky, exposure and cameras and all that moves in it, each in the frame of its box.

    After OmniRe (Chen et al., arXiv 2408.16760): a scene graph of a static background and rigid nodes, learnt
    from whole images with 0.8 L1 + 0.2 (1 - SSIM) and LiDAR depth, boxes refined in every frame. Its PSNR and
    SSIM on the frames that teach are the geometric consistency that DriveWeaver reports (arXiv 2606.31918):
    what no one world explains lowers them. Parked vehicles are part of the street. People and riders are rigid
    here, too: what their legs do is part of the error. Every 8th instant is held out, and judges.

    Args:
        scene: A recorded drive, or a generated video of one: its pixels are taken as they are.
        config: By default `ReconstructConfig.joint`.
        insertion: The vehicle that the generator put in, if it did: it becomes the actor `INSERTED`.
        checkpoint: Where an interrupted fit goes on, to the same bytes.

    Returns:
        As the generator's return value, what was reconstructed, and a report of JSON values (`evaluate_whole`).

    Raises:
        InputError: The scene has no LiDAR, or none that its cameras see; the insertion ends before the clip.
    """
    begin = time.perf_counter()
    config = config or ReconstructConfig.joint()
    if insertion is not None:
        insertion.trajectory.require([frame.camera.time for frame in scene.all_frames()])
    prepared = yield from prepare(scene, config)
    hits = {sweep.frame_index: hits_on_movers(scene, sweep) for sweep in scene.sweeps}
    trajectories = {track.id: track.trajectory for track in scene.tracks}
    views = [unmask(view, hits.get(view.frame.index, {}), trajectories) for view in prepared.views]
    movers = find_movers(scene, views, hits)
    if insertion is not None:
        movers[INSERTED] = insertion
    traffic = Traffic(movers, prepared.teaching)
    street = Street(scene, prepared.teaching, prepared.gaussians, prepared.sky, traffic)
    yield from learn(street, views, config, checkpoint)

    background = street.to_background(prepared.judging)
    provenance = {"scene": scene.name, "config": asdict(config)}
    reconstruction = Reconstruction(background, tuple(traffic.to_actors(street.groups(), provenance)))
    report = evaluate_whole(reconstruction, scene, {frame.index for frame in prepared.judging}, config.threads)
    report |= summary(street, background, config) | {"seconds": round(time.perf_counter() - begin, 2)}
    report["gaussians_of_actors"] = sum(len(actor.asset.gaussians) for actor in reconstruction.actors)
    scored = zip(reconstruction.actors, report["actors"], strict=True)
    actors = tuple(replace(actor, asset=replace(actor.asset, quality=quality)) for actor, quality in scored)
    yield Evaluated(config.steps, report["psnr_train"])
    return replace(reconstruction, actors=actors), report
