// EXPORT: a scene as a file that other programs read: binary glTF, or the composition beside it.
#include "engine/assets/gltf/write/glb_file.h"
#include "protocol/blocks.h"
#include "protocol/text.h"
#include "server/jobs/services.h"
#include "server/requests/request.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

/// Bytes of a piece of the file, at most.
constexpr std::uint64_t piece_bytes_max = 1ULL << 20;
constexpr const char* advice = "export a smaller scene, or wait until others have ended";

class ExportJob final : public Job {
public:
    /// `glb` is empty for the .glb itself, else its name in the composition.
    ExportJob(const Services& services, const Caller& caller, NamedScene scene, std::string glb)
        : services_(services),
          caller_(caller),
          scene_(std::move(scene)),
          glb_(std::move(glb)),
          piece_bytes_(std::min(piece_bytes_max, caller.window_bytes / 2) - protocol::alignment) {}

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
        for (const std::string& line : file_->warnings())
            message.notes.push_back(protocol::clean_text(line, services_.limits.text_bytes_max));
        Frames frames;
        frames.push_back(*protocol::encode(caller_.request_id, message));
        return frames;
    }
    std::optional<Task> next() override {
        if (running_ || finished()) return std::nullopt;
        const std::uint64_t offset = sent_;
        const std::uint64_t count = std::min(piece_bytes_, total() - offset);
        sent_ += count;
        running_ = true;
        Task task;
        task.reply_bytes_max = protocol::padded(count);
        task.run = [this, offset, count](const Stop&) { return piece(offset, count); };
        return task;
    }
    Reply<void> ended() override {
        running_ = false;
        return {};
    }
    [[nodiscard]] bool finished() const override { return prepared_ && sent_ == total(); }
    [[nodiscard]] std::uint64_t held_bytes() const override {
        return prepared_ ? lease_->bytes() : 0;
    }
    [[nodiscard]] std::optional<Progress> progress() const override {
        if (!prepared_) return std::nullopt;
        return Progress{sent_, total(), "writing"};
    }
    Frames farewell() override {
        Frames frames;
        frames.push_back(*protocol::encode(caller_.request_id, wire::DoneT{}));
        return frames;
    }

private:
    Reply<void> make(const Stop& stop) {
        const Snapshot& scene = scene_.snapshot();
        const auto refused = [&](Error error) {
            error.message = "cannot export scene '" + scene_.name + "': " + error.message;
            return refuse(error);
        };
        const auto most = gltf::GlbFile::memory_max(scene);
        if (!most) return refused(most.error());
        // Budget is thread-safe. What others hold is not taken away for an export.
        lease_ = services_.budget.reserve(*most, caller_.principal);
        if (!lease_)
            return services_.budget.refuse("the export of scene '" + scene_.name + "'", *most,
                                           caller_.principal, advice);
        auto file = gltf::GlbFile::make(scene, [&stop] { return stop.requested(); });
        if (!file) return refused(file.error());
        file_ = std::move(*file);
        if (!glb_.empty()) text_ = gltf::composition_text(scene, glb_);
        return {};
    }

    [[nodiscard]] std::uint64_t total() const {
        return glb_.empty() ? file_->bytes() : text_.size();
    }

    Reply<Frames> piece(std::uint64_t offset, std::uint64_t count) const {
        protocol::Bulk bulk;
        bulk.add("data", wire::Dtype::u8, 1, count);
        bulk.allocate();
        if (glb_.empty())
            file_->read(offset, bulk.block(0));
        else
            std::ranges::copy(std::as_bytes(std::span(text_)).subspan(offset, count),
                              bulk.block(0).begin());
        wire::PictureT message;
        message.width = message.height = 1;
        message.encode = glb_.empty() ? "glb" : "json";
        message.offset = offset;
        message.total = total();
        auto frame = protocol::encode(caller_.request_id, std::move(message), std::move(bulk),
                                      services_.limits);
        if (!frame) return tl::unexpected(frame.error());
        Frames frames;
        frames.push_back(std::move(*frame));
        return frames;
    }

    const Services& services_;
    const Caller caller_;
    const NamedScene scene_;
    const std::string glb_;
    const std::uint64_t piece_bytes_;
    // Made by prepare()'s task.
    std::optional<Budget::Lease> lease_;
    std::optional<gltf::GlbFile> file_;
    std::string text_;
    bool prepared_ = false;
    bool running_ = false;
    std::uint64_t sent_ = 0;
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
    auto scene = services.scenes.find(protocol::text(message->scene()), message->epoch(), caller);
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
