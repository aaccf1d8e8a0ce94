// All that an intersector or a primitive of the user's needs to include.
#pragma once

#include "engine/bvh/ask.h"
#include "engine/bvh/box_test.h"
#include "engine/geometry/intersect_triangle.h"
#include "engine/geometry/record.h"
#include "engine/intersectors/params.h"
