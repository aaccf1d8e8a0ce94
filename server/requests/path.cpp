// PATH: converts a path number to the names of its instances, and names to a number.
#include "engine/geometry/hit.h"
#include "engine/scene/snapshot.h"
#include "protocol/text.h"
#include "server/documents/scene_info.h"
#include "server/requests/request.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <charconv>
#include <memory>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

/// Refuses as INVALID_FIELD what the engine calls an invalid scene: the request names no path.
tl::unexpected<protocol::Error> no_such_path(const Error& error) {
    return refuse(Code::invalid_field, error.message);
}

Reply<wire::PathNameT> describe(const Snapshot& scene, std::uint64_t path,
                                const protocol::Limits& limits) {
    wire::PathNameT name;
    name.path = path;
    if (path == no_path) return name;
    const auto steps = expand_path(scene, path);
    if (!steps) return no_such_path(steps.error());
    name.name = protocol::clean_text(path_name(*steps), limits.text_bytes_max);
    for (const PathStep& step : *steps) {
        name.steps.push_back(protocol::clean_text(step.name, limits.name_bytes_max));
        name.instances.push_back(step.instance);
        name.uids.push_back(step.uid);
        name.nodes.push_back(step.node);
    }
    return name;
}

/// Finds a path by text in a task: a scene may have millions of names, too many for the io thread.
class PathJob final : public Job {
public:
    PathJob(const Services& services, const Caller& caller, NamedScene scene, std::string text)
        : limits_(services.limits),
          id_(caller.request_id),
          scene_(std::move(scene)),
          text_(std::move(text)) {}

    std::optional<Task> next() override {
        if (std::exchange(started_, true)) return std::nullopt;
        Task task;
        task.run = [this](const Stop&) -> Reply<Frames> {
            const auto path = find_path(scene_.snapshot(), text_);
            if (!path) return no_such_path(path.error());
            const auto name = describe(scene_.snapshot(), *path, limits_);
            if (!name) return tl::unexpected(name.error());
            auto frame = protocol::encode(id_, *name, limits_);
            if (!frame) return tl::unexpected(frame.error());
            frame_ = std::move(*frame);
            return Frames{};
        };
        return task;
    }
    [[nodiscard]] bool finished() const override { return started_; }
    Frames farewell() override {
        Frames frames;
        frames.push_back(std::move(frame_));
        return frames;
    }

private:
    const protocol::Limits& limits_;
    const std::uint64_t id_;
    const NamedScene scene_;
    const std::string text_;
    bool started_ = false;
    protocol::Frame frame_;  ///< written by the task
};

}  // namespace

Reply<Answer> path(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Path>& message) {
    const auto scene =
        services.scenes.find_to_read(protocol::text(message->scene()), message->epoch(), caller);
    if (!scene) return tl::unexpected(scene.error());
    const std::string_view text = protocol::text(message->text());
    std::uint64_t path = message->path();
    if (std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; })) {
        const auto parsed = std::from_chars(text.data(), text.data() + text.size(), path);
        if (!text.empty() && parsed.ec != std::errc())
            return refuse(Code::invalid_field, "the scene has no path " + std::string(text));
        const auto name = describe(scene->snapshot(), path, services.limits);
        if (!name) return tl::unexpected(name.error());
        return answer_with(caller, *name, services);
    }
    JobSubmission accepted;
    accepted.kind = "path";
    accepted.scene = scene->name;
    accepted.deadline_ms = message->deadline_ms();
    accepted.job = std::make_unique<PathJob>(services, caller, *scene, std::string(text));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
