// The strip below a heat map that says what its colours mean.
//
//   forest   camera main
//   total per ray (boxes + primitives)
//   [==================== palette =====================]
//   |          |          |           |                |
//   0         100        200         300             412+
//   min 0   mean 123.4   p50 101   p99 412   max 1023   clipped 1.0 %
#pragma once

#include "engine/integrators/palette.h"
#include "engine/integrators/picture.h"

namespace raynest {

/// Where a count stands between the two ends of the palette.
struct HeatScale {
    double low;
    double high;
    bool logarithmic;      ///< in 1 + the distance from `low`, so that 0 has a place
    bool centred = false;  ///< a difference: low = -high, and 0 stands in the middle

    /// 0 to 1; what lies beyond an end stands at that end.
    [[nodiscard]] double position(double count) const;
};

/// Adds the strip below the picture, as wide as it. A picture narrower than heat_picture_width_min
/// first gets an empty margin on its right, so that no text is ever cut and pixel (x, y) stays
/// where it is.
void append_legend(Picture& picture, const Palette& palette, const HeatScale& scale,
                   const HeatStatistics& statistics, const HeatOptions& options);

}  // namespace raynest
