"""The paper's equations as loops in float64 numpy, independent of the code under test.

Weights are float64 arrays by their names in the state dict. Shapes follow the model's dimension key.
"""

import numpy as np
from torch import nn

Array = np.ndarray
Weights = dict[str, Array]


def weights_of(module: nn.Module) -> Weights:
    """The state dict of `module` as float64 arrays."""
    return {name: tensor.detach().double().numpy() for name, tensor in module.state_dict().items()}


def part(weights: Weights, name: str) -> Weights:
    """The weights of the submodule `name`."""
    return {key.removeprefix(name + "."): array for key, array in weights.items() if key.startswith(name + ".")}


# --- Layers -----------------------------------------------------------------------------------------------------


def linear(weights: Weights, x: Array) -> Array:
    """x (..., in) to (..., out)."""
    return x @ weights["weight"].T + weights["bias"]


def relu(x: Array) -> Array:
    return np.maximum(x, 0)


def softmax(x: Array) -> Array:
    exponentials = np.exp(x - x.max(axis=-1, keepdims=True))
    return exponentials / exponentials.sum(axis=-1, keepdims=True)


def layer_norm(weights: Weights, x: Array, eps: float = 1e-5) -> Array:
    centred = x - x.mean(axis=-1, keepdims=True)
    return centred / np.sqrt((centred**2).mean(axis=-1, keepdims=True) + eps) * weights["weight"] + weights["bias"]


def batch_norm(weights: Weights, x: Array, eps: float = 1e-5) -> Array:
    """x (C, ...), with the running statistics."""
    mean, var, scale, shift = (
        weights[name].reshape(-1, *[1] * (x.ndim - 1)) for name in ("running_mean", "running_var", "weight", "bias")
    )
    return (x - mean) / np.sqrt(var + eps) * scale + shift


def convolve(kernel: Array, x: Array, stride: int = 1, padding: int = 0) -> Array:
    """Cross-correlation of x (C, ...), padded with zeros, with a kernel (O, C, ...) in two or three dimensions."""
    extents = kernel.shape[2:]
    x = np.pad(x, [(0, 0)] + [(padding, padding)] * len(extents))
    sizes = [(size - extent) // stride + 1 for size, extent in zip(x.shape[1:], extents, strict=True)]
    out = np.zeros((kernel.shape[0], *sizes))
    for offset in np.ndindex(*extents):
        window = [slice(o, o + stride * (size - 1) + 1, stride) for o, size in zip(offset, sizes, strict=True)]
        out += np.einsum("oc,c...->o...", kernel[(..., *offset)], x[(slice(None), *window)])
    return out


def deformable_convolution(weights: Weights, x: Array, stride: int = 1) -> Array:
    """Zhu et al. (2019), eq. 1, with a 3×3 kernel on x (C, H, W), padded with zeros.

    The channels of `conv_offset` are Δy and Δx [px] of the first point, of the second, ..., then the logits of the
    nine masks.
    """
    predicted = _convolve_with_bias(part(weights, "conv_offset"), x, stride, 1)
    return modulated_sum(weights["weight"], x, predicted[:18], 1 / (1 + np.exp(-predicted[18:])), stride)


def modulated_sum(kernel: Array, x: Array, offsets: Array, masks: Array, stride: int = 1) -> Array:
    """y(p) = Σ_k w_k x(p + p_k + Δp_k) Δm_k: kernel (O, C, 3, 3), x (C, H, W), offsets (18, h, w), masks (9, h, w)."""
    image = x.transpose(1, 2, 0)
    out = np.zeros((len(kernel), *masks.shape[1:]))
    for i, j, point in np.ndindex(*out.shape[1:], 9):
        row = i * stride - 1 + point // 3 + offsets[2 * point, i, j]
        column = j * stride - 1 + point % 3 + offsets[2 * point + 1, i, j]
        sample = bilinear(image, column + 0.5, row + 0.5)
        out[:, i, j] += kernel[:, :, point // 3, point % 3] @ sample * masks[point, i, j]
    return out


def max_pool(x: Array, size: int, stride: int, padding: int = 0) -> Array:
    """x (C, H, W)."""
    x = np.pad(x, [(0, 0), (padding, padding), (padding, padding)], constant_values=-np.inf)
    height, width = ((extent - size) // stride + 1 for extent in x.shape[1:])
    out = np.zeros((x.shape[0], height, width))
    for i, j in np.ndindex(height, width):
        out[:, i, j] = x[:, i * stride : i * stride + size, j * stride : j * stride + size].max(axis=(1, 2))
    return out


def stretch(x: Array, height: int, width: int) -> Array:
    """Enlarge x (C, h, w) to (C, height, width) by the nearest neighbour, with indices rounded down."""
    out = np.zeros((x.shape[0], height, width))
    for i, j in np.ndindex(height, width):
        out[:, i, j] = x[:, i * x.shape[1] // height, j * x.shape[2] // width]
    return out


# --- Image encoder ----------------------------------------------------------------------------------------------


def resnet(weights: Weights, image: Array, depths: tuple[int, ...], caffe_style: bool, eps: float) -> list[Array]:
    """He et al. (2016): image (3, H, W) to C3, C4, C5.

    A block with a third convolution is a bottleneck. A convolution with `conv_offset` is deformable.
    """
    x = relu(batch_norm(part(weights, "bn1"), convolve(weights["conv1.weight"], image, 2, 3), eps))
    x = max_pool(x, 3, 2, 1)
    stages = []
    for stage, depth in enumerate(depths):
        for index in range(depth):
            stride = 2 if stage > 0 and index == 0 else 1
            x = _residual_block(part(weights, f"layer{stage + 1}.{index}"), x, stride, caffe_style, eps)
        stages.append(x)
    return stages[1:]


def _residual_block(weights: Weights, x: Array, stride: int, caffe_style: bool, eps: float) -> Array:
    bottleneck = "conv3.weight" in weights
    strides = (stride, 1, 1) if caffe_style or not bottleneck else (1, stride, 1)
    last = 3 if bottleneck else 2
    out = x
    for number in range(1, last + 1):
        convolution, stride_here = part(weights, f"conv{number}"), strides[number - 1]
        kernel = convolution["weight"]
        if "conv_offset.weight" in convolution:
            out = deformable_convolution(convolution, out, stride_here)
        else:
            out = convolve(kernel, out, stride_here, kernel.shape[-1] // 2)
        out = batch_norm(part(weights, f"bn{number}"), out, eps)
        out = out if number == last else relu(out)
    if "downsample.0.weight" in weights:
        x = batch_norm(part(weights, "downsample.1"), convolve(weights["downsample.0.weight"], x, stride), eps)
    return relu(out + x)


def feature_pyramid(weights: Weights, features: list[Array]) -> list[Array]:
    """Lin et al. (2017): top-down sums of the laterals, a 3×3 convolution on each, and an extra level from the last."""
    merged = [_convolve_with_bias(part(weights, f"lateral.{i}"), feature) for i, feature in enumerate(features)]
    for i in (1, 0):
        merged[i] = merged[i] + stretch(merged[i + 1], *merged[i].shape[1:])
    levels = [_convolve_with_bias(part(weights, f"output.{i}"), level, 1, 1) for i, level in enumerate(merged)]
    return [*levels, _convolve_with_bias(part(weights, "extra"), levels[-1], 2, 1)]


def _convolve_with_bias(weights: Weights, x: Array, stride: int = 1, padding: int = 0) -> Array:
    return convolve(weights["weight"], x, stride, padding) + weights["bias"].reshape(-1, *[1] * (x.ndim - 1))


# --- Geometry ---------------------------------------------------------------------------------------------------


def project(point: Array, image_T_ego: Array, width_px: int, height_px: int) -> tuple[float, float] | None:
    """Project a point (3) [m] to fractions of width and height. None if it is not visible. image_T_ego (3, 4) [px]."""
    u, v, depth_m = image_T_ego @ np.array([*point, 1.0])
    if not depth_m > 0.1:
        return None
    u_px, v_px = u / depth_m, v / depth_m
    return (u_px / width_px, v_px / height_px) if 0 <= u_px < width_px and 0 <= v_px < height_px else None


def step_back_on_the_plane(pose: Array, past_T_now: Array, delta_s: float) -> Array:
    """Supplement, eqs. 1-4, for one pose vector (10) and one step between adjacent frames."""
    x, y, z, *log_size, sin, cos, vx, vy = pose
    moved = np.array([x - delta_s * vx, y - delta_s * vy, z])  # eq. 1
    position = past_T_now[:3, :3] @ moved + past_T_now[:3, 3]  # eq. 2
    rotation = past_T_now[:2, :2]
    past_cos, past_sin = rotation @ [cos, sin]  # eq. 3
    velocity = rotation @ [vx, vy]  # eq. 4
    return np.array([*position, *log_size, past_sin, past_cos, *velocity])


def step_back_in_space(
    state: tuple[Array, Array, Array], past_T_now: Array, delta_s: float
) -> tuple[Array, Array, Array]:
    """The same step for any rotation. State: position [m], heading and velocity [m/s], each with three numbers."""
    position, heading, velocity = state
    rotation, translation = past_T_now[:3, :3], past_T_now[:3, 3]
    return rotation @ (position - delta_s * velocity) + translation, rotation @ heading, rotation @ velocity


# --- Attention --------------------------------------------------------------------------------------------------


def bilinear(image: Array, x_px: float, y_px: float) -> Array:
    """The image (H, W, C) at a position [px]. The centre of the first pixel is (0.5, 0.5). Outside are zeros."""
    column, row = x_px - 0.5, y_px - 0.5
    left, top = int(np.floor(column)), int(np.floor(row))
    total = np.zeros(image.shape[-1])
    for r in (top, top + 1):
        for c in (left, left + 1):
            if 0 <= r < image.shape[0] and 0 <= c < image.shape[1]:
                total += (1 - abs(row - r)) * (1 - abs(column - c)) * image[r, c]
    return total


def multi_scale_deformable_attention(
    value: Array, spatial_shapes: list[tuple[int, int]], locations: Array, weights: Array
) -> Array:
    """Zhu et al. (2021), eq. 3, without the projections: value (B, ΣHW, heads, C/heads); returns (B, Q, C)."""
    batch, num_queries, num_heads, num_levels, num_points, _ = locations.shape
    ends = np.cumsum([height * width for height, width in spatial_shapes])
    result = np.zeros((batch, num_queries, num_heads, value.shape[-1]))
    for b, q, h, l, p in np.ndindex(batch, num_queries, num_heads, num_levels, num_points):  # noqa: E741
        height, width = spatial_shapes[l]
        level = value[b, ends[l] - height * width : ends[l], h].reshape(height, width, -1)
        x, y = locations[b, q, h, l, p]
        result[b, q, h] += weights[b, q, h, l, p] * bilinear(level, x * width, y * height)
    return result.reshape(batch, num_queries, -1)


def deformable_attention(
    weights: Weights,
    query: Array,
    references: list[dict[int, tuple[float, float]]],
    features: list[Array],
    num_heads: int,
) -> Array:
    """MSDA with its layers: query (Q, C), features[j] (N, C, H_j, W_j).

    references[q]: for each view in which query q is visible, its reference point as fractions of width and height.
    Offsets are in cells of their level. Weights add up to one over levels and points.
    """
    channels = query.shape[-1]
    values = [_convolve_views(part(weights, "value"), level) for level in features]
    result = np.zeros_like(query)
    for q, views in enumerate(references):
        offsets = linear(part(weights, "offsets"), query[q]).reshape(num_heads, len(features), -1, 2)
        attention = softmax(linear(part(weights, "weights"), query[q]).reshape(num_heads, -1))
        attention = attention.reshape(offsets.shape[:-1])
        attended = np.zeros(channels)
        for view, (x, y) in views.items():
            for h, j, p in np.ndindex(*attention.shape):
                head = slice(h * channels // num_heads, (h + 1) * channels // num_heads)
                level = values[j][view][..., head]
                sample = bilinear(
                    level, x * level.shape[1] + offsets[h, j, p, 0], y * level.shape[0] + offsets[h, j, p, 1]
                )
                attended[head] += attention[h, j, p] * sample / len(views)
        result[q] = linear(part(weights, "output"), attended)
    return result


def _convolve_views(weights: Weights, level: Array) -> Array:
    """A 1×1 convolution of (N, C, H, W), with the result (N, H, W, C)."""
    return np.einsum("oc,nchw->nhwo", weights["weight"][:, :, 0, 0], level) + weights["bias"]


def bev_attention(weights: Weights, query: Array, poses: Array, bev: Array, config) -> Array:
    """Eqs. 5-6. bev (C, X, Y) is an image with the height X and the width Y."""
    lower_m, upper_m = config.voxels.lower_m, config.voxels.upper_m
    references = []
    for x_m, y_m, *_ in poses:
        along_x = (x_m - lower_m[0]) / (upper_m[0] - lower_m[0])
        along_y = (y_m - lower_m[1]) / (upper_m[1] - lower_m[1])
        references.append({0: (along_y, along_x)})
    return deformable_attention(part(weights, "deformable"), query, references, [bev[None]], config.num_heads)


def pv_attention(
    weights: Weights, query: Array, poses: Array, pv: list[Array], image_T_ego: Array, camera_valid: Array, config
) -> Array:
    """Eqs. 7-8, averaged over the cameras in which the reference point is visible; zero if there is none."""
    references = []
    for pose in poses:
        projected = {
            camera: project(pose[:3], image_T_ego[camera], config.image.width_px, config.image.height_px)
            for camera in np.flatnonzero(camera_valid)
        }
        references.append({camera: point for camera, point in projected.items() if point is not None})
    attended = deformable_attention(part(weights, "deformable"), query, references, pv, config.num_heads)
    return np.array([row if views else 0 * row for row, views in zip(attended, references, strict=True)])


def self_attention(weights: Weights, z: Array, num_heads: int) -> Array:
    """Vaswani et al. (2017), for each head and query: the paper's eq. 4 with Q = K = V = z (Q, C)."""
    num_queries, channels = z.shape
    query, key, value = np.split(linear(part(weights, "query_key_value"), z), 3, axis=-1)
    out = np.zeros_like(z)
    for h in range(num_heads):
        head = slice(h * channels // num_heads, (h + 1) * channels // num_heads)
        for q in range(num_queries):
            scores = [query[q, head] @ key[k, head] / np.sqrt(channels / num_heads) for k in range(num_queries)]
            out[q, head] = sum(w * value[k, head] for k, w in enumerate(softmax(np.array(scores))))
    return linear(part(weights, "output"), out)


# --- Lifter and divergence enhancement ----------------------------------------------------------------------------


def lift(reduction: Array, pv: list[Array], image_T_ego: Array, camera_valid: Array, config) -> tuple[Array, Array]:
    """F_voxel (C, Z, X, Y), and the number of cameras (Z, X, Y) in which each voxel is visible. reduction (C, in)."""
    num_x, num_y, num_z = config.voxels.size
    lower_m, upper_m = np.array(config.voxels.lower_m), np.array(config.voxels.upper_m)
    voxels = np.zeros((reduction.shape[0], num_z, num_x, num_y))
    counts = np.zeros((num_z, num_x, num_y), dtype=int)
    for i, j, k in np.ndindex(num_x, num_y, num_z):
        centre = lower_m + (np.array([i, j, k]) + 0.5) / config.voxels.size * (upper_m - lower_m)
        for camera in np.flatnonzero(camera_valid):
            position = project(centre, image_T_ego[camera], config.image.width_px, config.image.height_px)
            if position is None:
                continue
            counts[k, i, j] += 1
            for level in pv:
                image = level[camera].transpose(1, 2, 0)
                sample = bilinear(image, position[0] * image.shape[1], position[1] * image.shape[0])
                voxels[:, k, i, j] += reduction @ sample / len(pv)
        if counts[k, i, j]:
            voxels[:, k, i, j] /= counts[k, i, j]
    return voxels, counts


def divergence_enhancement(weights: Weights, voxels: Array) -> Array:
    """F_voxel (C, Z, X, Y) to F_BEV: three Conv3D; height z of channel c becomes channel c·Z + z; three Conv2D."""
    for i in range(3):
        voxels = _convolution_block(part(weights, f"conv3d.{i}"), voxels)
    channels, num_z, num_x, num_y = voxels.shape
    bev = np.zeros((channels * num_z, num_x, num_y))
    for c, z in np.ndindex(channels, num_z):
        bev[c * num_z + z] = voxels[c, z]
    for i in range(3):
        bev = _convolution_block(part(weights, f"conv2d.{i}"), bev)
    return bev


def _convolution_block(weights: Weights, x: Array, first: int = 0) -> Array:
    """3×3 convolution (module `first`), BatchNorm (module `first + 1`) and ReLU."""
    return relu(batch_norm(part(weights, str(first + 1)), convolve(weights[f"{first}.weight"], x, padding=1)))


# --- Segmentation -----------------------------------------------------------------------------------------------


def segmentation(weights: Weights, bev: Array, names: tuple[str, ...]) -> dict[str, Array]:
    """A U-Net (Ronneberger et al., 2015) with two steps, and a head for each mask."""
    fine = _double_block(part(weights, "enter"), bev)
    middle = _double_block(part(weights, "down.0"), max_pool(fine, 2, 2))
    coarse = _double_block(part(weights, "down.1"), max_pool(middle, 2, 2))
    middle = _double_block(part(weights, "up.0"), np.concatenate((stretch(coarse, *middle.shape[1:]), middle)))
    fine = _double_block(part(weights, "up.1"), np.concatenate((stretch(middle, *fine.shape[1:]), fine)))
    heads = {name: part(weights, f"heads.{name}") for name in names}
    return {name: _convolve_with_bias(part(head, "3"), _convolution_block(head, fine)) for name, head in heads.items()}


def _double_block(weights: Weights, x: Array) -> Array:
    return _convolution_block(weights, _convolution_block(weights, x), first=3)


# --- Decoder ----------------------------------------------------------------------------------------------------


def pose_encoder(weights: Weights, pose: Array, unit: Array) -> Array:
    """Eq. 1: Q_Pose (..., C) of a pose (..., 10), divided by `unit`."""
    x = layer_norm(part(weights, "encoder.2"), relu(linear(part(weights, "encoder.0"), pose / unit)))
    x = layer_norm(part(weights, "encoder.5"), relu(linear(part(weights, "encoder.3"), x)))
    return linear(part(weights, "xi"), x)


def recurrence(weights: Weights, attended: list[Array], frame_valid: Array) -> Array:
    """The recurrence over attended[t] (Q, C), t frames ago, from the oldest to the newest. It starts from zero."""
    state = np.zeros_like(attended[0])
    for t in range(len(attended) - 1, -1, -1):
        if frame_valid[t]:
            hidden = relu(linear(part(weights, "mlp.0"), np.concatenate((state, attended[t]), axis=-1)))
            state = linear(part(weights, "mlp.4"), relu(linear(part(weights, "mlp.2"), hidden)))
    return state


def decoder_layer(
    weights: Weights,
    config,
    content: Array,
    poses: Array,
    embeddings: Array,
    pv: list[list[Array]],
    bev: list[Array],
    window: dict[str, Array],
) -> tuple[Array, Array, Array]:
    """Fig. 3 and eqs. 2-8. Returns the new content, class logits and pose.

    content: Q_BEV ⊕ Q_PV (Q, 2C), or one of them (Q, C). poses (T, Q, 10) and embeddings Q_Pose (T, Q, C): index 0 is
    the current frame. pv[t]: F_PV^j (N, C, H_j, W_j). bev[t]: F_BEV (C, X, Y).
    """
    z = content + np.concatenate([embeddings[0]] * (content.shape[-1] // embeddings.shape[-1]), axis=-1)
    mixed = self_attention(part(weights, "self_attention"), z, config.num_heads)
    content = layer_norm(part(weights, "self_attention_norm"), content + mixed)

    def attend_in(space: str, content: Array, first: int = 0) -> Array:
        """Attention in one space. content: of the queries from number `first` on."""
        own, queries = part(weights, f"cross_attention.{space}"), slice(first, first + len(content))
        attended = []
        for t, features in enumerate(bev if space == "bev" else pv):
            z, past_poses = content + embeddings[t, queries], poses[t, queries]
            if space == "bev":
                attended.append(bev_attention(part(own, "attention"), z, past_poses, features, config))
            else:
                cameras = window["image_T_ego"][t], window["camera_valid"][t]
                attended.append(pv_attention(part(own, "attention"), z, past_poses, features, *cameras, config))
        return layer_norm(
            part(own, "norm"), content + recurrence(part(own, "recurrence"), attended, window["frame_valid"])
        )

    half = len(content) // 2
    if config.queries == "duo":
        bev_content, pv_content = np.split(content, 2, axis=-1)
        content = np.concatenate((attend_in("bev", bev_content), attend_in("pv", pv_content)), axis=-1)
    elif config.queries == "shared_content":
        content = attend_in("bev", attend_in("pv", content))
    elif config.queries == "unshared":
        content = np.concatenate((attend_in("bev", content[:half]), attend_in("pv", content[half:], half)))
    else:
        content = attend_in(config.queries, content)

    fed = linear(part(weights, "feedforward.2"), relu(linear(part(weights, "feedforward.0"), content)))
    content = layer_norm(part(weights, "feedforward_norm"), content + fed)
    class_logits = _head(part(weights, "heads.classes"), content)
    return content, class_logits, poses[0] + _head(part(weights, "heads.refinement"), content)


def _head(weights: Weights, x: Array) -> Array:
    hidden = layer_norm(part(weights, "2"), relu(linear(part(weights, "0"), x)))
    return linear(part(weights, "3"), hidden)


# --- Fusion of past BEV features ------------------------------------------------------------------------------------


def align_with_current_frame(bev: Array, past_T_now: Array, config) -> Array:
    """Sample bev (C, X, Y) of a past ego frame at the cell centres of the current ego frame, on the ground."""
    lower_m, upper_m = np.array(config.voxels.lower_m[:2]), np.array(config.voxels.upper_m[:2])
    aligned = np.zeros_like(bev)
    for i, j in np.ndindex(bev.shape[1:]):
        centre = lower_m + (np.array([i, j]) + 0.5) / bev.shape[1:] * (upper_m - lower_m)
        past_centre = (past_T_now @ np.array([*centre, 0.0, 1.0]))[:2]
        row, column = (past_centre - lower_m) / (upper_m - lower_m) * bev.shape[1:]
        aligned[:, i, j] = bilinear(bev.transpose(1, 2, 0), column, row)
    return aligned


def recurrent_stacking(weights: Weights, frames: list[Array], window: dict[str, Array], config) -> Array:
    """frames[t] (C, X, Y), t frames ago: each is stacked on the fused features before it, and convolved."""
    state = np.zeros_like(frames[0])
    for t in range(len(frames) - 1, -1, -1):
        if window["frame_valid"][t]:
            now = align_with_current_frame(frames[t], window["past_T_now"][t], config)
            state = _convolution_block(part(weights, "fuse"), np.concatenate((state, now)))
    return state


def temporal_self_attention(weights: Weights, frames: list[Array], window: dict[str, Array], config) -> Array:
    """Li et al. (2022), eq. 5: each cell attends to the fused features before it and to the frame; the mean of both."""
    state = None
    for t in range(len(frames) - 1, -1, -1):
        if window["frame_valid"][t]:
            now = align_with_current_frame(frames[t], window["past_T_now"][t], config)
            state = _attend_in_bev(weights, now, now if state is None else state, config.num_heads)
    return state


def _attend_in_bev(weights: Weights, now: Array, past: Array, num_heads: int) -> Array:
    own, channels = part(weights, "attention"), len(now)
    values = [_convolve_views(part(own, "value"), features[None])[0] for features in (past, now)]
    result = np.zeros_like(now)
    for i, j in np.ndindex(now.shape[1:]):
        query = np.concatenate((past[:, i, j], now[:, i, j]))
        offsets = linear(part(own, "offsets"), query).reshape(2, num_heads, -1, 2)
        attention = softmax(linear(part(own, "weights"), query).reshape(2, num_heads, -1))
        attended = np.zeros(channels)
        for m, h, p in np.ndindex(*attention.shape):
            head = slice(h * channels // num_heads, (h + 1) * channels // num_heads)
            position = j + 0.5 + offsets[m, h, p, 0], i + 0.5 + offsets[m, h, p, 1]
            attended[head] += attention[m, h, p] / 2 * bilinear(values[m][..., head], *position)
        result[:, i, j] = layer_norm(part(weights, "norm"), now[:, i, j] + linear(part(own, "output"), attended))
    return result
