// EXPORT: a scene as a file that other programs read: binary glTF, or the composition beside it.
#include "engine/assets/gltf/write/glb_file.h"
#include "protocol/answer.h"
#include "protocol/text.h"
#include "server/jobs/payload_sender.h"
#include "server/jobs/services.h"
#include "server/requests/request.h"
#include "server/requests/words/at_moment.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

constexpr const char* advice = "export a smaller scene, or wait until others have ended";

class ExportJob final : public Job {
public:
    /// `glb` is empty for the .glb itself, else its name in the composition.
    ExportJob(const Services& services, const Caller& caller, NamedScene scene, std::string glb)
        : services_(services),
          caller_(caller),
          scene_(std::move(scene)),
          glb_(std::move(glb)),
          sender_(services.limits, caller, glb_.empty() ? "glb" : "json") {}

    std::optional<Task> prepare() override {
        Task task;
        task.run = [this](const Stop& stop) -> Reply<Frames> {
            if (auto made = make(stop); !made) return tl::unexpected(made.error());
            return Frames{};
        };
        return task;
    }
    Frames greeting() override {
        prepared_ = true;
        wire::StartedT message;
        message.scene = scene_.name;
        message.hash = scene_.snapshot().digest();
        message.epoch = scene_.epoch;
        const WorldPoint& origin = scene_.snapshot().origin();
        message.origin_x = origin[0];
        message.origin_y = origin[1];
        message.origin_z = origin[2];
        if (file_)
            for (const std::string& line : file_->warnings())
                message.notes.push_back(
                    protocol::clean_text(line, services_.limits.text_bytes_max));
        Frames frames;
        frames.push_back(protocol::answer(caller_.request_id, message));
        return frames;
    }
    std::optional<Task> next() override { return sender_.next(); }
    Reply<void> ended() override {
        sender_.ended();
        return {};
    }
    [[nodiscard]] bool finished() const override { return prepared_ && sender_.finished(); }
    [[nodiscard]] std::uint64_t held_bytes() const override {
        return (prepared_ ? lease_.bytes() : 0) + scene_.left_bytes(caller_.principal);
    }
    [[nodiscard]] std::optional<Progress> progress() const override {
        if (!prepared_) return std::nullopt;
        return Progress{sender_.sent(), sender_.total(), "writing"};
    }
    Frames farewell() override {
        Frames frames;
        frames.push_back(protocol::answer(caller_.request_id, wire::DoneT{}));
        return frames;
    }

private:
    Reply<void> make(const Stop& stop) {
        const Snapshot& scene = scene_.snapshot();
        Payload payload;
        payload.width = payload.height = 1;
        if (!glb_.empty()) {
            const std::string text = gltf::composition_text(scene, glb_);
            const auto bytes = std::as_bytes(std::span(text));
            payload.bytes.assign(bytes.begin(), bytes.end());
            sender_.set(std::move(payload));
            return {};
        }
        const auto refused = [&](Error error) {
            error.message = "cannot export scene '" + scene_.name + "': " + error.message;
            return refuse(error);
        };
        const auto most = gltf::GlbFile::memory_max(scene);
        if (!most) return refused(most.error());
        // Budget is thread-safe. What others hold is not taken away for an export.
        auto lease = services_.budget.reserve(*most, caller_.principal);
        if (!lease)
            return services_.budget.refuse("the export of scene '" + scene_.name + "'", *most,
                                           caller_.principal, advice);
        lease_ = std::move(*lease);
        auto file = gltf::GlbFile::make(scene, [&stop] { return stop.requested(); });
        if (!file) return refused(file.error());
        file_ = std::move(*file);
        sender_.set(std::move(payload), file_->bytes(),
                    [this](std::uint64_t offset, std::span<std::byte> into) -> Reply<void> {
                        file_->read(offset, into);
                        return {};
                    });
        return {};
    }

    const Services& services_;
    const Caller caller_;
    const NamedScene scene_;
    const std::string glb_;
    PayloadSender sender_;
    // Made by prepare()'s task.
    Budget::Lease lease_;
    std::optional<gltf::GlbFile> file_;  ///< nothing for a composition
    bool prepared_ = false;
};

}  // namespace

Reply<Answer> export_scene(const Services& services, const Caller& caller,
                           const protocol::Opened<wire::Export>& message) {
    const std::string_view format = protocol::text(message->format());
    if (format != "glb" && format != "rnscene.json")
        return refuse(Code::invalid_field, "unknown format '" + std::string(format) +
                                               "' of export: use one of glb, rnscene.json");
    std::string file;
    if (format == "rnscene.json") {
        file = protocol::text(message->file());
        if (!file.ends_with(".glb") || file.find('/') != std::string::npos)
            return refuse(Code::invalid_field,
                          "a composition refers to a .glb beside it, by a name without folders");
    }
    auto scene =
        services.scenes.find_to_read(protocol::text(message->scene()), message->epoch(), caller);
    if (!scene) return tl::unexpected(scene.error());
    scene = at_moment(services, caller, std::move(*scene), moment_words(*message.table));
    if (!scene) return tl::unexpected(scene.error());
    JobSubmission accepted;
    accepted.kind = "export";
    accepted.detail = format;
    accepted.scene = scene->name;
    accepted.deadline_ms = message->deadline_ms();
    accepted.advice = advice;
    accepted.answer_bytes = caller.window_bytes;
    accepted.job =
        std::make_unique<ExportJob>(services, caller, std::move(*scene), std::move(file));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
