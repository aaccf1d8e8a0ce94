// The cost of an edit: one of many instances of a sphere moves, over a build of the same scene, and
// over what Embree's top level costs where Embree is there. CPU time of the whole process; best of
// each. The cost of moves at the rim of a flat field, within groups and by text. The memory and cost
// of 1,000 epochs, each of which somebody holds. With VERTICES, the cost of a skinned mesh of so many
// at another moment.
//
//   raynest-bench-edits [INSTANCES] [ROUNDS] [VERTICES]      prints one JSON object
#include "engine/scene/edits/edit.h"
#include "tests/bench/edits/measured.h"
#include "tests/bench/edits/parts.h"
#include "tests/bench/edits/skin.h"

#include <nlohmann/json.hpp>

#if RAYNEST_EMBREE == 4
#include <embree4/rtcore.h>
#elif RAYNEST_EMBREE == 3
#include <embree3/rtcore.h>
#endif

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace {

using namespace raynest;
using bench::best_of;
using bench::built;
using bench::cpu;

GeometryDescription sphere() {
    constexpr int rings = 16, segments = 24;
    GeometryDescription mesh;
    for (int ring = 0; ring <= rings; ++ring)
        for (int s = 0; s < segments; ++s) {
            const float a = 3.14159265F * static_cast<float>(ring) / rings;
            const float b = 6.2831853F * static_cast<float>(s) / segments;
            mesh.positions.emplace_back(std::sin(a) * std::cos(b), std::cos(a),
                                        std::sin(a) * std::sin(b));
        }
    for (std::uint32_t ring = 0; ring < rings; ++ring)
        for (std::uint32_t s = 0; s < segments; ++s) {
            const std::uint32_t a = ring * segments + s, b = ring * segments + (s + 1) % segments;
            mesh.indices.insert(mesh.indices.end(),
                                {a, b, a + segments, b, b + segments, a + segments});
        }
    return mesh;
}

Transform at(std::uint32_t i, std::uint32_t count, float shift) {
    const auto side = static_cast<std::uint32_t>(std::cbrt(static_cast<double>(count))) + 1;
    const auto place = [&](std::uint32_t n) { return 3 * static_cast<float>(n % side); };
    return {{1, 0, 0, place(i) + shift, 0, 1, 0, place(i / side), 0, 0, 1, place(i / side / side)}};
}

/// Memory of this process; what is mapped several times counts once.
double resident_bytes() {
    std::ifstream status("/proc/self/smaps_rollup");
    for (std::string line; std::getline(status, line);) {
        double kib = 0;
        if (std::sscanf(line.c_str(), "Pss: %lf kB", &kib) == 1) return kib * 1024;
    }
    throw std::runtime_error("the system does not tell the memory of this process");
}

#ifdef RAYNEST_EMBREE
/// CPU seconds of a commit of the top level after one instance has moved.
double embree_commit(const GeometryDescription& mesh, std::uint32_t count, int rounds,
                     RTCBuildQuality quality) {
    RTCDevice device = rtcNewDevice(nullptr);
    RTCScene object = rtcNewScene(device);
    RTCGeometry triangles = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    void* positions =
        rtcSetNewGeometryBuffer(triangles, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                sizeof(Vec3), mesh.positions.size());
    std::copy(mesh.positions.begin(), mesh.positions.end(), static_cast<Vec3*>(positions));
    void* indices = rtcSetNewGeometryBuffer(triangles, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                            12, mesh.indices.size() / 3);
    std::copy(mesh.indices.begin(), mesh.indices.end(), static_cast<std::uint32_t*>(indices));
    rtcCommitGeometry(triangles);
    rtcAttachGeometry(object, triangles);
    rtcCommitScene(object);
    RTCScene top = rtcNewScene(device);
    rtcSetSceneFlags(top, RTC_SCENE_FLAG_DYNAMIC);
    rtcSetSceneBuildQuality(top, quality);
    std::vector<RTCGeometry> instances;
    const auto place = [&](std::uint32_t i, float shift) {
        const Transform t = at(i, count, shift);
        rtcSetGeometryTransform(instances[i], 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, t.m.data());
        rtcCommitGeometry(instances[i]);
    };
    for (std::uint32_t i = 0; i < count; ++i) {
        instances.push_back(rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE));
        rtcSetGeometryInstancedScene(instances[i], object);
        place(i, 0);
        rtcAttachGeometry(top, instances[i]);
    }
    rtcCommitScene(top);
    const double commit = best_of(rounds, [&](int round) {
        place(count / 2, 0.1F * static_cast<float>(round % 7));
        rtcCommitScene(top);
    });
    for (RTCGeometry instance : instances) rtcReleaseGeometry(instance);
    rtcReleaseGeometry(triangles);
    rtcReleaseScene(top);
    rtcReleaseScene(object);
    rtcReleaseDevice(device);
    return commit;
}
#endif

void run(std::uint32_t count, int rounds, std::uint32_t vertices) {
    SceneDescription description;
    description.objects.resize(2);
    description.objects[0].geometries.push_back(sphere());
    for (std::uint32_t i = 0; i < count; ++i) {
        InstanceDescription one;
        one.object = 0;
        one.transform = at(i, count, 0);
        description.objects[1].instances.push_back(one);
    }
    description.root = 1;
    const double build = best_of(std::max(2, rounds / 10), [&](int) { built(description); });

    auto scene = built(description);
    std::shared_ptr<const Snapshot> before;
    const auto edit = [&](std::vector<InstanceMove> moves) {
        auto next = edit_scene(*scene, {std::move(moves), {}, {}, {}}, std::move(before));
        if (!next) throw std::runtime_error(next.error().message);
        before = std::exchange(scene, std::move(*next));
    };
    const double one = best_of(rounds, [&](int round) {
        edit({{count / 2, at(count / 2, count, 0.1F * static_cast<float>(round % 7))}});
    });
    std::vector<InstanceMove> every;
    const double all = best_of(std::max(2, rounds / 10), [&](int round) {
        every.clear();
        for (std::uint32_t i = 0; i < count; ++i)
            every.push_back({i, at(i, count, 0.1F * static_cast<float>(round % 7))});
        edit(every);
    });
    // An epoch that is held leaves no memory to the edit after the next.
    std::vector<std::shared_ptr<const Snapshot>> held;
    const auto edit_and_hold = [&](std::uint32_t which, int round) {
        const Transform to = at(which, count, 0.1F * static_cast<float>(round % 7));
        auto next = edit_scene(*scene, {{{which, to}}, {}, {}, {}});
        if (!next) throw std::runtime_error(next.error().message);
        held.push_back(std::exchange(scene, std::move(*next)));
    };
    for (int i = 0; i < 3; ++i) edit_and_hold(0, i);  // what all share is written once
    constexpr int epochs = 1000;
    nlohmann::json held_rows;
    for (const auto& [name, step] : {std::pair{"same", 0U}, std::pair{"others", 97U}}) {
        held.clear();
        const double resident = resident_bytes(), begin = cpu();
        for (int i = 0; i < epochs; ++i)
            edit_and_hold((count / 2 + static_cast<std::uint32_t>(i) * step) % count, i);
        const double seconds = (cpu() - begin) / epochs;
        held_rows[name] = {{"move_cpu_seconds", seconds},
                           {"move_over_build", seconds / build},
                           {"bytes_per_epoch", (resident_bytes() - resident) / epochs}};
    }

    nlohmann::json answer{{"instances", count},
                          {"build_cpu_seconds", build},
                          {"move_one_cpu_seconds", one},
                          {"move_all_cpu_seconds", all},
                          {"move_one_over_build", one / build},
                          {"move_all_over_build", all / build},
                          {"scene_bytes", scene->bytes().size()},
                          {"held", held_rows},
                          {"parts", bench::part_figures(count, rounds)}};
#ifdef RAYNEST_EMBREE
    const double low = embree_commit(description.objects[0].geometries[0], count,
                                     std::max(3, rounds / 5), RTC_BUILD_QUALITY_LOW);
    answer["embree"] = RAYNEST_EMBREE;
    answer["embree_commit_low_cpu_seconds"] = low;
    answer["move_one_over_embree_commit"] = one / low;
#endif
    if (vertices != 0) answer.update(bench::skin_figures(vertices, rounds));
    std::cout << answer.dump(2) << '\n';
}

}  // namespace

int main(int count, char** arguments) {
    const std::vector<std::string> words(arguments + 1, arguments + count);
    const auto is_number = [](const std::string& word) {
        return !word.empty() && word.find_first_not_of("0123456789") == std::string::npos;
    };
    if (words.size() > 3 || !std::ranges::all_of(words, is_number)) {
        std::cerr << "for example: raynest-bench-edits 100000 50\n"
                     "raynest-bench-edits [INSTANCES [ROUNDS [VERTICES]]]\n";
        return 2;
    }
    const auto number = [&](std::size_t i, int otherwise) {
        return i < words.size() ? std::stoi(words[i]) : otherwise;
    };
    try {
        run(static_cast<std::uint32_t>(number(0, 100'000)), number(1, 50),
            static_cast<std::uint32_t>(number(2, 0)));
        return 0;
    } catch (const std::exception& error) {
        std::cerr << "raynest-bench-edits: " << error.what() << '\n';
        return 1;
    }
}
