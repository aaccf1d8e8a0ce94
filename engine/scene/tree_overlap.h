// How much the trees of a scene overlap what they do not hold.
//
// EPO, the effective parent overlap (Aila, Karras, Laine, "On quality metrics of bounding volume
// hierarchies", 2013), is the cost of nodes around a point of a surface that hold other surfaces.
// SAH counts the boxes that rays meet on their way, EPO those that they meet in vain where they end.
#pragma once

#include "engine/geometry/views.h"

#include <vector>

namespace raynest {

/// Returns the EPO of each object's tree, with the trees of its instances, in the costs of
/// TreeStatistics::sah_cost. It is NaN where no triangle has an area, and where overlaps are too
/// many to be looked at. Estimated at points of triangles, the same for the same scene, and for objects
/// that are equal. Takes a look at each triangle and instance, and less than a second for the points.
std::vector<double> measure_overlaps(const SceneView& scene);
/// The same of the outermost object alone.
double measure_overlap(const SceneView& scene);

}  // namespace raynest
