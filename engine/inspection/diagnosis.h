// Findings in the work of a picture: they say why a scene is slow, and how to help it.
#pragma once

#include "engine/inspection/blame.h"

#include <cstdint>
#include <string>
#include <vector>

namespace raynest {

/// A figure beyond its threshold.
struct Finding {
    std::string name;             ///< a name in findings.def
    std::string subject;          ///< name of a mesh or material in the file
    bool is_material = false;     ///< else an object
    std::uint32_t index = no_id;  ///< that object's or material's index
    double figure = 0;
    double threshold = 0;
    bool below = false;  ///< true: the figure should not be below the threshold; false: not above
    std::string unit;    ///< what the figure counts
    double share = 0;    ///< the part of all work that was spent in the subject
    std::string remedy;
};

/// Findings by their row in findings.def, the subject with the most work first. Linear in the rows
/// and in the triangles of the meshes that they name.
[[nodiscard]] std::vector<Finding> diagnose(const Blame& blame);

}  // namespace raynest
