// Finds all hits of a plain list, with buffer and budget as small as possible.
#include "engine/geometry/sphere.h"
#include "engine/queries/range.h"

#include <doctest/doctest.h>

#include <vector>

using namespace raynest;

namespace {

/// A record with an alignment requirement.
template <int alignment>
struct alignas(alignment) Point {
    float x, y, z, unused;
};
template <int alignment>
Box bounds(const Point<alignment>& p) {
    return {{p.x, p.y, p.z}, {p.x, p.y, p.z}};
}
template <class R, int alignment>
auto intersect(const R&, const Point<alignment>& p) {
    return no_hits<1>(p);
}
static_assert(RecordPrimitive<Point<4>>);
static_assert(!RecordPrimitive<Point<16>>);  // records are only aligned to words

/// Returns ten spheres in a row, the farthest first: a ray along it has twenty hits.
std::vector<Sphere> row_of_spheres() {
    std::vector<Sphere> spheres;
    for (int i = 9; i >= 0; --i) spheres.push_back({Vec3(0, 0, 10.0F * static_cast<float>(i)), 1});
    return spheres;
}

struct Found {
    std::vector<HitRecord> hits;
    bool truncated = false;
    bool fits = true;
};

Found find(std::uint32_t budget, std::size_t room_size) {
    const std::vector<Sphere> spheres = row_of_spheres();
    std::vector<HitRecord> room(room_size);
    AllHits query{room, budget};
    Opaque opaque;
    trace_range({Vec3(0, 0, -5), 0, Vec3(0, 0, 1)}, spheres.begin(), spheres.end(), opaque, query);
    query.finish();
    room.resize(query.count);
    return {room, query.truncated, query.fits};
}

}  // namespace

TEST_CASE("all hits are sorted, and only more than the budget are too many") {
    for (const std::uint32_t budget : {20U, 21U, 4096U}) {
        const Found found = find(budget, 8192);
        REQUIRE(found.hits.size() == 20);
        CHECK(!found.truncated);
        for (std::size_t i = 0; i < 20; ++i) {
            const float center = 5 + 10.0F * static_cast<float>(i / 2);
            CHECK(found.hits[i].t == center + (i % 2 == 0 ? -1 : 1));
            CHECK(found.hits[i].k == i % 2);
        }
    }
}

TEST_CASE("the nearest hits within the budget are kept, in a buffer for twice as many") {
    for (const std::uint32_t budget : {1U, 2U, 7U, 19U}) {
        CAPTURE(budget);
        for (const std::size_t room :
             {std::size_t{2} * budget, std::size_t{2} * budget + 1, std::size_t{100}}) {
            const Found found = find(budget, room);
            CHECK(found.fits);
            CHECK(found.truncated);
            REQUIRE(found.hits.size() == budget);
            CHECK(found.hits[0].t == 4);
            CHECK(found.hits[budget - 1].t < 10.0F * static_cast<float>((budget + 1) / 2));
        }
    }
}

TEST_CASE("a buffer that is too small is reported, not overrun") {
    CHECK(!find(20, 0).fits);
    CHECK(!find(20, 19).fits);
    CHECK(find(20, 20).fits);
}
