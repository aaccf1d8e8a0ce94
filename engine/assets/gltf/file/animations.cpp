// Animations. What of them cannot be played is left out with a warning: the scene is there without.
#include "engine/assets/gltf/file/convert.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <tuple>

namespace raynest::gltf {
namespace {

/// Keys that may be decoded beyond those that the file's bytes allow.
constexpr std::uint64_t free_floats = 1ULL << 23;

std::optional<Interpolation> interpolation_of(const std::string& word) {
    if (word == "STEP") return Interpolation::step;
    if (word == "LINEAR" || word.empty()) return Interpolation::linear;
    if (word == "CUBICSPLINE") return Interpolation::cubic;
    return std::nullopt;
}

class Reader {
public:
    explicit Reader(Model& model) : model_(model) {}

    void read(const tinygltf::Animation& in) {
        Animation animation{one_line(in.name), {}};
        const std::string where = label("animation", model_.animations.size(), in.name);
        for (const tinygltf::AnimationChannel& channel : in.channels) {
            if (channel.target_node == -1) continue;  // its target is another one
            if (const char* const fault = add(in, channel, animation); fault != nullptr)
                model_.odd.add(where, fault);
        }
        if (!animation.channels.empty()) model_.animations.push_back(std::move(animation));
    }

private:
    /// Returns why a channel is left out, or null.
    const char* add(const tinygltf::Animation& in, const tinygltf::AnimationChannel& channel,
                    Animation& out) {
        if (channel.target_node < 0 ||
            static_cast<std::size_t>(channel.target_node) >= model_.nodes.size())
            return "a channel names a node that the file lacks; it is left out";
        Node& node = model_.nodes[static_cast<std::size_t>(channel.target_node)];
        static const std::map<std::string, MotionPath, std::less<>> paths{
            {"translation", MotionPath::translation},
            {"rotation", MotionPath::rotation},
            {"scale", MotionPath::scale},
            {"weights", MotionPath::weights}};
        const auto path = paths.find(channel.target_path);
        if (path == paths.end())
            return "a channel moves what RayNest does not move; it is left out";
        const bool is_weights = path->second == MotionPath::weights;
        std::uint64_t width = path->second == MotionPath::rotation ? 4 : 3;
        if (is_weights) {
            width = node.mesh == no_id || model_.meshes[node.mesh].primitives.empty()
                        ? 0
                        : model_.meshes[node.mesh].primitives.front().targets.size();
            if (width == 0)
                return "a channel has weights for a mesh without targets; it is left out";
        } else if (node.has_matrix) {
            return "a channel moves a node that has a matrix; it is left out";
        }
        if (channel.sampler < 0 || static_cast<std::size_t>(channel.sampler) >= in.samplers.size())
            return "a channel has no sampler; it is left out";
        const auto sampler = sampler_of(in.samplers[static_cast<std::size_t>(channel.sampler)],
                                        static_cast<std::uint32_t>(width), is_weights);
        if (!sampler) return "a sampler's keys cannot be read; its channels are left out";
        out.channels.push_back(
            {*sampler, static_cast<std::uint32_t>(channel.target_node), path->second});
        (is_weights ? node.has_moving_weights : node.is_animated) = true;
        return nullptr;
    }

    std::optional<std::uint32_t> sampler_of(const tinygltf::AnimationSampler& in,
                                            std::uint32_t width, bool is_weights) {
        const auto interpolation = interpolation_of(in.interpolation);
        if (!interpolation || !is_accessor(in.input) || !is_accessor(in.output))
            return std::nullopt;
        const auto [known, is_new] =
            samplers_.try_emplace({in.input, in.output, *interpolation, width});
        if (is_new) known->second = make_sampler(in, *interpolation, width, is_weights);
        return known->second;
    }

    [[nodiscard]] bool is_accessor(int index) const {
        return index >= 0 && static_cast<std::size_t>(index) < model_.accessors.size();
    }

    std::optional<std::uint32_t> make_sampler(const tinygltf::AnimationSampler& in,
                                              Interpolation interpolation, std::uint32_t width,
                                              bool is_weights) {
        const Accessor& input = model_.accessors[static_cast<std::size_t>(in.input)];
        const Accessor& output = model_.accessors[static_cast<std::size_t>(in.output)];
        const std::uint64_t values = (interpolation == Interpolation::cubic ? 3 : 1) * input.count;
        const bool fits = input.width == 1 && input.component == Component::f32 &&
                          input.count != 0 && output.scalar_or_vector &&
                          (output.component == Component::f32 || output.normalized) &&
                          (is_weights ? output.width == 1 && output.count == values * width
                                      : output.width == width && output.count == values);
        if (!fits) return std::nullopt;
        const auto times = floats_of(in.input);
        const auto first_value = floats_of(in.output);
        if (!times || !first_value) return std::nullopt;
        const std::span<const float> keys(model_.key_floats.data() + *times, input.count);
        if (keys.front() < 0 || keys.back() > motion_seconds_max ||
            !std::ranges::is_sorted(keys, std::less_equal()))
            return std::nullopt;
        model_.samplers.push_back(
            {*times, static_cast<std::uint32_t>(input.count), *first_value, width, interpolation});
        return static_cast<std::uint32_t>(model_.samplers.size() - 1);
    }

    /// Reads the numbers of an accessor once; nothing if they are damaged or not finite.
    std::optional<std::uint32_t> floats_of(int index) {
        const auto [known, is_new] = read_.try_emplace(index);
        if (!is_new) return known->second;
        const Accessor& accessor = model_.accessors[static_cast<std::size_t>(index)];
        std::vector<float>& all = model_.key_floats;
        if (!accessor.fault.empty() ||
            all.size() + accessor.count * accessor.width > free_floats + model_.upload_bytes)
            return std::nullopt;
        const auto values = read_floats(accessor);
        if (!values || !std::ranges::all_of(*values, [](float x) { return std::isfinite(x); }))
            return std::nullopt;
        known->second = static_cast<std::uint32_t>(all.size());
        all.insert(all.end(), values->begin(), values->end());
        return known->second;
    }

    Model& model_;
    std::map<int, std::optional<std::uint32_t>> read_;  ///< by accessor
    std::map<std::tuple<int, int, Interpolation, std::uint32_t>, std::optional<std::uint32_t>>
        samplers_;
};

}  // namespace

Result<void> convert_animations(tinygltf::Model& file, Model& model) {
    Reader reader(model);
    if (file.animations.size() > motion_animations_max)
        model.odd.add("the file",
                      fmt::format("has more than {} animations; the others are left out",
                                  motion_animations_max));
    for (const tinygltf::Animation& animation : file.animations) {
        if (model.animations.size() == motion_animations_max) break;
        reader.read(animation);
    }
    return {};
}

}  // namespace raynest::gltf
