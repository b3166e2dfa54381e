"""A video of the drive behind the scene, in step with it however slowly the film runs: in the view and in pictures.

    frame of the video = 1 + video's rate * (t - start)        t: time of the drive at a frame of the film

What the video itself shows of the land is not drawn again: ground and strip are hidden, the sky is transparent.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from .keyframes import CONSTANT, animate

HIDDEN = ("ground", "strip")


def behind(scene: Any, camera: Any, arrays: Any, given: Any) -> None:
    """Lay the video behind what this camera sees. given : `file`, and `start`, s after the start of the trajectory."""
    clip = bpy.data.movieclips.load(given["file"])
    rate, count = clip.fps, clip.frame_duration
    bpy.data.movieclips.remove(clip)
    frames = np.arange(scene.frame_start, scene.frame_end + 1)
    elapsed = np.interp(frames, arrays["frame"], arrays["elapsed"])
    shown = np.clip(1 + np.floor((elapsed - given["start"]) * rate + 1e-6), 1, count)
    image = bpy.data.images.load(given["file"])
    backdrop = camera.data.background_images.new()
    backdrop.image, backdrop.alpha, backdrop.display_depth, backdrop.frame_method = image, 1.0, "BACK", "FIT"
    camera.data.show_background_images = True
    tree, source = _below(scene, image)
    for user in (backdrop.image_user, source):
        user.frame_start, user.frame_duration = scene.frame_start, len(frames)
    path, offset = "background_images[0].image_user.frame_offset", shown - (frames - scene.frame_start + 1)
    animate(camera.data, "CAMERA", frames, [(path, 0, offset)], CONSTANT)
    animate(tree, "NODETREE", frames, [(f'nodes["{source.name}"].frame_offset', 0, offset)], CONSTANT)
    scene.render.film_transparent = True
    for name in HIDDEN:
        for thing in (part for part in scene.objects if part.name.split(".")[0] == name):
            thing.hide_render = thing.hide_viewport = True


def _below(scene: Any, image: Any) -> tuple[Any, Any]:
    """Nodes that lay the picture over the image: the tree, and the node of the image."""
    tree, out = _compositor(scene)
    kinds = ("CompositorNodeImage", "CompositorNodeScale", "CompositorNodeRLayers", "CompositorNodeAlphaOver")
    source, scale, layers, over = (tree.nodes.new(kind) for kind in kinds)
    source.name, source.image, layers.scene = "video", image, scene
    if hasattr(scale, "space"):
        scale.space, scale.frame_method = "RENDER_SIZE", "FIT"
    else:
        scale.inputs["Type"].default_value, scale.inputs["Frame Type"].default_value = "Render Size", "Fit"
    below, above = [socket for socket in over.inputs if socket.type == "RGBA"]
    tree.links.new(source.outputs["Image"], scale.inputs[0])
    tree.links.new(scale.outputs[0], below)
    tree.links.new(layers.outputs["Image"], above)
    tree.links.new(over.outputs[0], out)
    return tree, source


def _compositor(scene: Any) -> tuple[Any, Any]:
    """The empty compositor of a scene, and the socket of its picture."""
    if bpy.app.version < (5, 0, 0):
        scene.use_nodes = True
        scene.node_tree.nodes.clear()
        return scene.node_tree, scene.node_tree.nodes.new("CompositorNodeComposite").inputs["Image"]
    tree = bpy.data.node_groups.new("video", "CompositorNodeTree")
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    scene.compositing_node_group = tree
    return tree, tree.nodes.new("NodeGroupOutput").inputs[0]
