#include "engine/inspection/diagnosis.h"

#include "engine/inspection/ranking.h"
#include "engine/queries/triangle_place.h"

#include <array>
#include <cstddef>
#include <optional>

namespace raynest {
namespace {

/// Subjects with a smaller share of all work are not looked at: a remedy would change nothing.
constexpr double share_min = 0.02;
/// Subjects of one finding, at most.
constexpr std::size_t subjects_max = 3;

double ratio(std::uint64_t part, std::uint64_t whole) {
    return whole == 0 ? 0 : static_cast<double>(part) / static_cast<double>(whole);
}

/// A row of a table, and the picture that it is of.
struct Subject {
    const SceneView& view;
    const RankedRow& row;
    std::uint64_t rays;   ///< the picture's rays
    std::uint64_t total;  ///< work of all rays
    [[nodiscard]] const ObjectRecord& object() const { return view.objects[row.key.index]; }
    [[nodiscard]] double share() const { return ratio(row.ranked, total); }
};

/// Each function measures a subject; nothing where the finding does not apply to it. Functions of
/// materials take rows of materials, the others those of objects.
using Measure = std::optional<double> (*)(const Subject&);

/// The row's own tree, with the trees of the instances in it: their boxes overlap where a ray that
/// hits one enters many.
std::optional<double> overlapping_instances(const Subject& subject) {
    const BlamedWork& work = subject.row.work;
    if (subject.object().instance_count < 2 || ratio(work.needed, subject.rays) < share_min)
        return std::nullopt;
    return ratio(work.entered, work.needed);
}

std::optional<double> thin_triangles(const Subject& subject) {
    const ObjectRecord& object = subject.object();
    if (object.triangle_count == 0 || subject.share() < share_min) return std::nullopt;
    const AreaSums sums = area_sums(subject.view, object);
    if (!(sums.boxes > 0)) return std::nullopt;
    return sums.share();
}

std::optional<double> crowded_leaves(const Subject& subject) {
    const ObjectRecord& object = subject.object();
    if (object.triangle_count == 0 || subject.share() < share_min) return std::nullopt;
    return triangles_in_one_place(subject.view, object);
}

/// The root's tree is none of them: a scene of one mesh has it.
std::optional<double> single_child_levels(const Subject& subject) {
    const ObjectRecord& object = subject.object();
    if (object.has_own_primitives() || object.instance_count != 1 ||
        subject.row.key.index == subject.view.root)
        return std::nullopt;
    return ratio(subject.row.work.rays, subject.rays);
}

std::optional<double> refusing_cutouts(const Subject& subject) {
    if (subject.share() < share_min || subject.row.work.candidates == 0) return std::nullopt;
    return ratio(subject.row.work.refused, subject.row.work.candidates);
}

enum class Of { objects, materials };
struct Row {
    const char* name;
    Of of;
    Measure measure;
    double threshold;
    bool below;
    const char* unit;
    const char* remedy;
};
constexpr bool above = false;
constexpr bool below = true;
constexpr std::array rows = {
#define RAYNEST_FINDING(name, of, threshold, side, unit, remedy) \
    Row{#name, Of::of, name, threshold, side, unit, remedy},
#include "engine/inspection/findings.def"
};

std::string name_of(const SceneView& view, const RankedRow& row, Of of) {
    if (of == Of::objects) return view.names + view.objects[row.key.index].name;
    return row.key.index == no_id ? "" : view.names + view.materials[row.key.index].name;
}

}  // namespace

std::vector<Finding> diagnose(const Blame& blame) {
    const SceneView& view = blame.scene().view();
    const Ranking objects = rank_all_objects(blame);
    const Ranking materials = rank(blame, BlameTable::materials);
    std::vector<Finding> findings;
    for (const Row& row : rows) {
        const Ranking& subjects = row.of == Of::materials ? materials : objects;
        std::size_t found = 0;
        for (const RankedRow& each : subjects.rows) {
            const Subject subject{view, each, blame.rays(), subjects.total};
            const auto figure = row.measure(subject);
            if (!figure || (row.below ? *figure >= row.threshold : *figure <= row.threshold))
                continue;
            findings.push_back({row.name, name_of(view, each, row.of), row.of == Of::materials,
                                each.key.index, *figure, row.threshold, row.below, row.unit,
                                subject.share(), row.remedy});
            if (++found == subjects_max) break;
        }
    }
    return findings;
}

}  // namespace raynest
