// STRUCTURE: how a scene is built, as a JSON document: objects, placements, boxes of trees, the texts
// of paths, or how good its trees are.
#include "protocol/answer.h"
#include "protocol/text.h"
#include "server/documents/structure_json.h"
#include "server/jobs/payload_sender.h"
#include "server/jobs/services.h"
#include "server/requests/request.h"
#include "server/requests/words/at_moment.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

constexpr std::uint32_t default_count = 256;
/// Bytes of a row or box, at most: in memory and as text, with names.
constexpr std::uint64_t row_bytes = 3 * 1024;
constexpr std::uint64_t box_bytes = 512;
/// Bytes of the document but for its rows, at most.
constexpr std::uint64_t head_bytes = 64 * 1024;

class StructureJob final : public Job {
public:
    StructureJob(const Services& services, const Caller& caller, NamedScene scene,
                 StructureRequest request, Budget::Lease lease)
        : limits_(services.limits),
          id_(caller.request_id),
          scene_(std::move(scene)),
          request_(std::move(request)),
          lease_(std::move(lease)),
          payload_(services.limits, caller, "json") {}

    std::optional<Task> next() override {
        if (described_) return payload_.next();
        if (std::exchange(started_, true)) return std::nullopt;
        Task task;
        task.run = [this](const Stop& stop) -> Reply<Frames> {
            auto text = structure_json(scene_, request_, limits_, stop);
            if (!text) return tl::unexpected(text.error());
            payload_.set(json_payload(1, 1, std::move(*text)));
            return Frames{};
        };
        return task;
    }
    Reply<void> ended() override {
        if (std::exchange(described_, true)) payload_.ended();
        return {};
    }
    [[nodiscard]] bool finished() const override { return described_ && payload_.finished(); }
    [[nodiscard]] std::uint64_t held_bytes() const override { return lease_.bytes(); }
    Frames farewell() override {
        Frames frames;
        frames.push_back(protocol::answer(id_, wire::DoneT{}));
        return frames;
    }

private:
    const protocol::Limits& limits_;
    const std::uint64_t id_;
    const NamedScene scene_;
    const StructureRequest request_;
    const Budget::Lease lease_;
    PayloadSender payload_;
    bool started_ = false;
    bool described_ = false;
};

std::optional<StructureRequest::Kind> parse_kind(std::string_view word) {
    if (word == "objects") return StructureRequest::Kind::objects;
    if (word == "placements") return StructureRequest::Kind::placements;
    if (word == "boxes") return StructureRequest::Kind::boxes;
    if (word == "paths") return StructureRequest::Kind::paths;
    if (word == "tree") return StructureRequest::Kind::tree;
    return std::nullopt;
}

}  // namespace

Reply<Answer> structure(const Services& services, const Caller& caller,
                        const protocol::Opened<wire::Structure>& message) {
    const std::string_view word = protocol::text(message->kind());
    const auto kind = parse_kind(word);
    if (!kind)
        return refuse(Code::invalid_field, "unknown kind '" + std::string(word) +
                                               "' of structure: use one of objects, placements, "
                                               "boxes, paths, tree");
    auto scene =
        services.scenes.find_to_read(protocol::text(message->scene()), message->epoch(), caller);
    if (!scene) return tl::unexpected(scene.error());
    scene = at_moment(services, caller, std::move(*scene), moment_words(*message.table));
    if (!scene) return tl::unexpected(scene.error());
    const SceneView& view = scene->snapshot().view();
    const std::uint32_t levels = view.objects[view.root].levels;
    const bool boxes = *kind == StructureRequest::Kind::boxes;
    if (boxes && message->level() >= levels)
        return refuse(Code::invalid_field,
                      "there is no level " + std::to_string(message->level()) + ": scene '" +
                          scene->name + "' has " + std::to_string(levels) +
                          (levels == 1 ? " level, level 0" : " levels, counted from 0"));

    std::vector<std::uint64_t> paths;
    if (*kind == StructureRequest::Kind::paths && message->paths() != nullptr)
        paths.assign(message->paths()->begin(), message->paths()->end());
    std::uint32_t count = message->count() == 0 ? default_count : message->count();
    if (*kind == StructureRequest::Kind::paths) count = static_cast<std::uint32_t>(paths.size());
    const std::uint64_t bytes = head_bytes + count * (boxes ? box_bytes : row_bytes);
    auto lease = services.peers.reserve(bytes, caller.principal);
    if (!lease)
        return services.budget.refuse("a document of " + std::to_string(count) + " rows", bytes,
                                      caller.principal, "ask for a smaller `count`");
    JobSubmission accepted;
    accepted.kind = "structure";
    accepted.detail = word;
    accepted.scene = scene->name;
    accepted.deadline_ms = message->deadline_ms();
    accepted.advice = "ask for a smaller `count`";
    accepted.answer_bytes = payload_answer_bytes(caller, bytes);
    accepted.job = std::make_unique<StructureJob>(
        services, caller, std::move(*scene),
        StructureRequest{*kind, message->first(), count, message->level(), message->depth_min(),
                         message->depth_max(), message->one(), std::move(paths)},
        std::move(*lease));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
