"""report.html: one self-contained page, for people."""

import base64
import html
import io
import math
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from PIL import Image

from dwgs.cli.films import FILMS
from dwgs.cli.progress import decibels
from dwgs.cli.render import rendered
from dwgs.files import new_file
from dwgs.scene import Scene

STILLS = 3


def write_page(out: Path, report: dict[str, Any], recorded: Scene, edited: Scene, graph) -> None:
    """Write ``out/report.html``; ``graph`` is the viewer's scene graph of background and vehicle."""
    template = Template((files("dwgs.cli") / "report.html").read_text())
    camera = recorded.frames[recorded.main_camera][0].camera
    before, after, orbit = (data_url(out / name, "video/mp4") for name in FILMS)
    distill, reconstruct = report["distill"], report["reconstruct"]
    text = template.substitute(
        title=f"{html.escape(recorded.name)} with a vehicle that was never there",
        subtitle=f"{len(edited.frames[edited.main_camera])} frames, {camera.width} x {camera.height} px",
        aspect=f"{camera.width} / {camera.height}",
        facts="".join(
            f"<div><b>{value}</b><span>{name}</span></div>"
            for name, value in (
                ("vehicle, held-out ROI PSNR", decibels(distill["psnr_roi_heldout"])),
                ("vehicle, held-out ROI SSIM", f"{distill['ssim_roi_heldout'] or math.nan:.4f}"),
                ("background, held-out PSNR", decibels(reconstruct["psnr_heldout"])),
                ("Gaussians of the vehicle", f"{distill['gaussians']:,}"),
                ("background unchanged", "yes" if report["background_unchanged"] else "NO"),
                ("everything", f"{report['seconds']:.0f} s"),
            )
        ),
        before=before,
        after=after,
        orbit=orbit,
        sides=sides(distill["sectors"]),
        sides_note="How much of the video shows the vehicle from each side, seen from above, front up, and how good "
        "the asset is from there on held-out frames. Sides without a wedge were never seen: there the asset shows "
        "what its points and its other side let one expect, in the light that the video shows. So do "
        f"{distill['gaussians_unseen']:,} Gaussians of its body that no frame saw; "
        f"of {100 * distill['share_completed_by_symmetry']:.0f} % of the body, frames saw the mirror image alone.",
        asset=asset_rows(distill),
        stills="".join(stills(recorded, edited, graph)),
        curves=curves({"vehicle (ROI)": distill["frames"], "background": reconstruct["frames"]}),
        stages="".join(stage_rows(report["stages"])),
        notes="<br>".join(html.escape(note) for note in report["assumed"]),
        command=html.escape(report["command"]),
        versions=", ".join(f"{name} {version}" for name, version in report["versions"].items()),
    )
    with new_file(out / "report.html") as draft:
        draft.write_text(text, encoding="utf-8")


def data_url(path: Path, media_type: str) -> str:
    """A file as a URL that holds it."""
    return f"data:{media_type};base64,{base64.b64encode(path.read_bytes()).decode()}"


def stills(recorded: Scene, edited: Scene, graph) -> list[str]:
    """Rows of recorded, edited and rendered frames, spread over the clip."""
    name = recorded.main_camera
    frames = list(zip(recorded.frames[name], edited.frames[name], strict=True))
    chosen = [frames[round(i)] for i in np.linspace(0, len(frames) - 1, STILLS + 2)[1:-1]]
    from viewer.renderer import Renderer

    with Renderer(chosen[0][0].camera.width, chosen[0][0].camera.height) as renderer:
        return [
            '<div class="three">'
            + picture(before.pixels, f"recorded, frame {before.index}")
            + picture(after.pixels, "edited")
            + picture(rendered(renderer, graph, graph.background, after), "background and asset, rendered")
            + "</div>"
            for before, after in chosen
        ]


def picture(pixels: np.ndarray, caption: str) -> str:
    """An image [H, W, 3] uint8 with a caption."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=88)
    url = f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode()}"
    return f'<figure><img src="{url}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'


def sides(sectors: Sequence[dict[str, Any]]) -> str:
    """A rose of how much each side was seen; sector 0 is centred on the front, sectors turn to the left."""
    count, most = len(sectors), max(*(sector["share"] for sector in sectors), 1e-9)
    wedges, labels = [], []
    for i, sector in enumerate(sectors):
        radius = 90 * math.sqrt(sector["share"] / most)
        angles = [2 * math.pi * (i + offset) / count for offset in (-0.5, 0, 0.5)]
        (x0, y0), (x, y), (x1, y1) = ((-math.sin(a), -math.cos(a)) for a in angles)
        if sector["frames"]:
            begin, end = (f"{radius * u:.1f} {radius * v:.1f}" for u, v in ((x0, y0), (x1, y1)))
            arc = f"M0 0L{begin}A{radius:.1f} {radius:.1f} 0 0 0 {end}Z"
            (low, high), (near, far) = sector["elevation_deg"], sector["distance_m"]
            note = f"{sector['frames']} frames, {low:g} to {high:g} degrees above it, {near:g} to {far:g} m away"
            wedges.append(f'<path d="{arc}"><title>{note}</title></path>')
        if sector["psnr_roi_heldout"] is not None:
            text = f"{sector['psnr_roi_heldout']:.1f} dB"
            labels.append(f'<text x="{118 * x:.1f}" y="{112 * y + 4:.1f}" text-anchor="middle">{text}</text>')
    return (
        '<svg viewBox="-150 -130 300 260" width="320" role="img" aria-label="sides seen">'
        '<circle r="90" fill="none" stroke="#dfe3e7"/><circle r="45" fill="none" stroke="#dfe3e7"/>'
        f'<g fill="#c2410c" fill-opacity=".55" stroke="#c2410c">{"".join(wedges)}</g>{"".join(labels)}'
        '<rect x="-9" y="-21" width="18" height="42" rx="5" fill="#fff" stroke="#1c2126"/></svg>'
    )


def asset_rows(distill: dict[str, Any]) -> str:
    """Rows of the table of what a user of the asset must know."""
    box, solid = (" x ".join(f"{side:.2f}" for side in distill[key]) for key in ("size", "extent"))
    rows = [
        ("box, length x width x height", f"{box} m"),
        ("what is solid fills", f"{solid} m"),
        ("frames that taught it", f"{distill['frames_taught']}"),
        ("pixels, held-out, on the vehicle itself", decibels(distill["psnr_object_heldout"])),
    ]
    if "pose_correction_rms_m" in distill:
        turn, shift = distill["pose_correction_rms_deg"], distill["pose_correction_rms_m"]
        rows.append(("poses were corrected by (root mean square)", f"{100 * shift:.1f} cm, {turn:.2f} degrees"))
    return "".join(f"<tr><td>{name}</td><td>{value}</td></tr>" for name, value in rows)


def curves(series: dict[str, Sequence[dict[str, Any]]]) -> str:
    """PSNR over frames, one line each; entries are {"frame", "psnr", "heldout"}."""
    width, height, left, bottom = 1000, 240, 40, 24
    points = [p for line in series.values() for p in line if p["psnr"] is not None]
    if not points:
        return ""
    frames, values = [p["frame"] for p in points], [p["psnr"] for p in points]
    low, high = math.floor(min(values)), math.ceil(max(values))
    span = max(max(frames) - min(frames), 1)

    def place(p: dict[str, Any]) -> tuple[float, float]:
        x = left + (width - left - 10) * (p["frame"] - min(frames)) / span
        return x, (height - bottom) * (1 - (p["psnr"] - low) / max(high - low, 1))

    parts = []
    for tick in range(low, high + 1, max(1, (high - low) // 5)):
        _, y = place({"frame": min(frames), "psnr": tick})
        parts.append(f'<line x1="{left}" x2="{width}" y1="{y:.1f}" y2="{y:.1f}" stroke="#dfe3e7"/>')
        parts.append(f'<text x="0" y="{y + 4:.1f}">{tick} dB</text>')
    for (name, line), color in zip(series.items(), ("#c2410c", "#2563eb"), strict=False):
        placed = [(*place(p), p["heldout"]) for p in line if p["psnr"] is not None]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in placed)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="1.5"/>')
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{color}"/>' for x, y, held in placed if held]
        x, y, _ = placed[-1]
        parts.append(f'<text x="{x:.1f}" y="{y - 8:.1f}" text-anchor="end" style="fill:{color}">{name}</text>')
    parts.append(f'<text x="{left}" y="{height}">frame {min(frames)}</text>')
    parts.append(f'<text x="{width}" y="{height}" text-anchor="end">frame {max(frames)}</text>')
    return f'<svg viewBox="0 -12 {width} {height + 16}" width="100%">{"".join(parts)}</svg>'


def stage_rows(stages: dict[str, dict[str, Any]]) -> list[str]:
    """Rows of the table of stages."""
    longest = max(stage["seconds"] for stage in stages.values()) or 1
    return [
        f"<tr><td>{name}{' (kept)' if stage['skipped'] else ''}</td><td>{stage['seconds']:.1f}</td>"
        f'<td class="bar"><i style="width:{100 * stage["seconds"] / longest:.1f}%"></i></td>'
        f"<td>{stage['peak_memory_mib']:.0f} MiB</td></tr>"
        for name, stage in stages.items()
    ]
