// The constants of the model, those of rasterize/inputs.py, and what follows from float32.
#pragma once

namespace roigs {

constexpr int kTile = 16;                        // side of a tile, px
constexpr float kNear = 0.01f;                   // nearest camera depth, scene units
constexpr float kAlphaMax = 0.999f;              // opacity cap per pixel
constexpr float kPlaneBlur = 0.01f;              // see plane.h, px^2
constexpr float kFrustumMargin = 0.3f;           // see linearisation point, geometry.h
constexpr float kLog2AlphaMin = -7.9943534369f;  // log2(1 / 255), the smallest alpha drawn
constexpr float kExponentScale = 0.7213475204f;  // log2(e) / 2: exp(-x / 2) = 2^(-x this)

// Culling takes Gaussians and pixel blocks whose log2(alpha) falls short of the limit by less
// than this, so that rounding never drops what the blending, which decides, would draw.
constexpr float kCullSlack = 1e-3f;

}  // namespace roigs
