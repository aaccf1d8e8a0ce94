// Mask rules for scenes that are described as objects and instances.
#include "engine/assets/input/mask_rules.h"
#include "engine/scene/path_table.h"

#include <deque>
#include <map>
#include <utility>

namespace raynest {
namespace {

/// Copies each object once per state in which the rules reach it, from the root down. Objects below
/// a settled state are shared; the mask of their instance applies to them.
class MaskWriter {
public:
    MaskWriter(MaskRules& rules, SceneDescription& scene) : rules_(rules), scene_(scene) {}

    Result<void> write() {
        scene_.root = copy_of(scene_.root, MaskRules::start());
        for (bool is_root = true; !open_.empty(); is_root = false) {
            const Copy copy = open_.front();
            open_.pop_front();
            if (auto done = fill(copy, is_root); !done) return done;
        }
        return {};
    }

private:
    struct Copy {
        std::uint32_t source;
        MaskRules::State state;
        std::uint32_t object;
    };

    std::uint32_t copy_of(std::uint32_t source, MaskRules::State state) {
        const auto next = static_cast<std::uint32_t>(scene_.objects.size());
        const auto [known, is_new] = copies_.try_emplace({source, state}, next);
        if (!is_new) return known->second;
        // A copy: the new element may move the others.
        std::string name = scene_.objects[source].name;
        scene_.objects.emplace_back().name = std::move(name);
        open_.push_back({source, state, next});
        return next;
    }

    Result<void> fill(const Copy& copy, bool is_root) {
        add_primitives(copy);
        const std::vector<std::string> texts = texts_of(copy.source);
        for (std::size_t i = 0; i < texts.size(); ++i) {
            InstanceDescription instance = scene_.objects[copy.source].instances[i];
            const auto state = rules_.step(copy.state, texts[i], is_root);
            if (!state) return tl::unexpected<Error>(state.error());
            if (rules_.is_settled(*state) || scene_.objects[instance.object].instances.empty())
                instance.mask = rules_.mask(*state).value_or(instance.mask);
            else
                instance.object = copy_of(instance.object, *state);
            scene_.objects[copy.object].instances.push_back(std::move(instance));
        }
        return {};
    }

    /// Gives an object's own primitives the mask of its placement. Where a rule sets that mask, the
    /// primitives move to an object of their own, placed beside the instances.
    void add_primitives(const Copy& copy) {
        ObjectDescription own = scene_.objects[copy.source];
        own.instances.clear();
        if (own.geometries.empty() && own.record_bounds.empty()) return;
        const auto mask = rules_.mask(copy.state);
        if (!mask) {
            scene_.objects[copy.object] = std::move(own);
            return;
        }
        const auto object = static_cast<std::uint32_t>(scene_.objects.size());
        scene_.objects.push_back(std::move(own));
        scene_.objects[copy.object].instances.push_back({object, Transform{}, *mask, 0, {}});
    }

    /// Returns the path steps of the object's instances, with their sibling numbers.
    [[nodiscard]] std::vector<std::string> texts_of(std::uint32_t object) const {
        std::vector<std::string> texts;
        NameIds ids;
        std::vector<std::uint32_t> names;
        for (const InstanceDescription& instance : scene_.objects[object].instances) {
            texts.push_back(step_name(scene_, instance));
            names.push_back(ids.of(texts.back()));
        }
        const std::vector<std::uint32_t> numbers = number_siblings(names);
        for (std::size_t i = 0; i < texts.size(); ++i) texts[i] = numbered(texts[i], numbers[i]);
        return texts;
    }

    MaskRules& rules_;
    SceneDescription& scene_;
    std::deque<Copy> open_;
    std::map<std::pair<std::uint32_t, MaskRules::State>, std::uint32_t> copies_;
};

}  // namespace

Result<void> apply_masks(MaskRules& rules, SceneDescription& scene) {
    if (rules.empty()) return {};
    if (auto done = MaskWriter(rules, scene).write(); !done) return done;
    rules.warn(scene);
    return {};
}

}  // namespace raynest
