// The only header that a user's intersector or primitive needs to include.
#pragma once

#include "engine/bvh/box_test.h"
#include "engine/bvh/intersect_with.h"
#include "engine/geometry/intersect_triangle.h"
#include "engine/geometry/record.h"
#include "engine/intersectors/params.h"
#include "engine/intersectors/refusal.h"
