// The constants of the model (the same as in rasterize/inputs.py), and limits that follow from
// float32.
#pragma once

namespace roigs {

constexpr int kTile = 16;                        // side of a tile, px
constexpr float kNear = 0.01f;                   // nearest camera depth, scene units
constexpr float kAlphaMax = 0.999f;              // opacity cap per pixel
constexpr float kPlaneBlur = 0.01f;              // see plane.h, px^2
constexpr float kFrustumMargin = 0.3f;           // see linearisation point, geometry.h
constexpr float kLog2AlphaMin = -7.9943534369f;  // log2(1 / 255), the smallest alpha drawn
constexpr float kExponentScale = 0.7213475204f;  // log2(e) / 2: exp(-x / 2) = 2^(-x this)

// Culling keeps Gaussians and pixel blocks whose log2(alpha) is below the limit by less than this.
// The blending decides; so rounding in the culling never drops a Gaussian that it would draw.
constexpr float kCullSlack = 1e-3f;

}  // namespace roigs
