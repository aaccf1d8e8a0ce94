#include "server/jobs/films/film_job.h"

#include "protocol/blocks.h"
#include "protocol/hash.h"
#include "protocol/text.h"
#include "server/documents/film_file.h"
#include "server/documents/scene_info.h"
#include "server/jobs/films/light_notes.h"
#include "server/jobs/films/received_picture.h"
#include "server/scheduling/dispatched_task.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <utility>

namespace raynest::server {
namespace {

/// Detached jobs keep their latest picture; it is encoded at most so often.
constexpr std::chrono::seconds kept_every{5};
/// Interval of the sums over all tiles that progress() tells.
constexpr std::chrono::milliseconds look_every{100};

/// Counts the rays of an integrator.
class CountingCaster final : public RayCaster {
public:
    explicit CountingCaster(RayCaster& base) : base_(base) {}
    JobStatistics::Counts counts;

    bool closest(std::span<const Ray> rays, std::span<HitRecord> hits) override {
        if (!base_.closest(rays, hits)) return false;
        std::uint64_t hit = 0;
        for (const HitRecord& record : hits.first(rays.size())) hit += record.hit;
        add(rays.size(), hit);
        return true;
    }
    using RayCaster::closest;
    bool occluded(std::span<const Ray> rays, std::span<std::uint8_t> answers) override {
        if (!base_.occluded(rays, answers)) return false;
        std::uint64_t hit = 0;
        for (const std::uint8_t answer : answers.first(rays.size())) hit += answer;
        add(rays.size(), hit);
        return true;
    }
    bool counted(std::span<const Ray> rays, std::span<HitRecord> hits,
                 std::span<Counters> counters) override {
        return base_.counted(rays, hits, counters);
    }
    bool observed(std::span<const Ray> rays, std::span<HitRecord> hits,
                  const Observer& observer) override {
        return base_.observed(rays, hits, observer);
    }

private:
    void add(std::uint64_t rays, std::uint64_t hit) {
        counts.rays += rays;
        counts.hits += hit;
        counts.misses += rays - hit;
    }
    RayCaster& base_;
};

/// Returns a number of three digits.
std::string rounded(double number) {
    std::array<char, 32> text{};
    std::snprintf(text.data(), text.size(), "%.3g", number);
    return text.data();
}

std::uint64_t tiles_of(const PictureRequest& request) {
    return FilmTiles::count_of({request.width, request.height});
}

}  // namespace

FilmJob::FilmJob(const Services& services, const Caller& caller, PictureRequest request, Plan any,
                 FilmOptions options)
    : PictureJob(services, caller, std::move(request), tiles_of(request) * options.passes.size()),
      any_(std::move(any)),
      options_(std::move(options)),
      best_by_(options_.best_by_ms == 0
                   ? Clock::time_point::max()
                   : Clock::now() + std::chrono::milliseconds(options_.best_by_ms)),
      tile_count_(tiles_of(this->request())),
      resumed_(0, options_.resume_bytes),
      environment_(1, options_.environment_bytes),
      stage_(resumed_.complete() && environment_.complete() ? Stage::preparing : Stage::receiving) {
}

Reply<std::uint64_t> FilmJob::feed(protocol::Frame frame) {
    const auto message = protocol::open<wire::Upload>(frame, services_.limits);
    if (!message) return tl::unexpected(message.error());
    const auto block = protocol::only_block(message->blocks, "data", wire::Dtype::u8, {1});
    if (!block) return tl::unexpected(block.error());
    if (stage_ != Stage::receiving)
        return refuse(Code::invalid_field, "the request's files are complete: send no more");
    ReceivedFile& file = resumed_.complete() ? environment_ : resumed_;
    const auto place = file.place(*message->table, block->count);
    if (!place) return tl::unexpected(place.error());
    const std::uint64_t freed =
        copies_.add(block->bytes.first(block->count), *place, std::move(frame));
    end_receiving();
    return freed;
}

void FilmJob::end_receiving() {
    if (resumed_.complete() && environment_.complete() && copies_.all_copied())
        stage_ = Stage::preparing;
}

std::optional<Task> FilmJob::next() {
    switch (stage_) {
        case Stage::preparing:
            if (std::exchange(task_started_, true)) return std::nullopt;
            return film_task();
        case Stage::tracing:
            if (auto work = next_work()) {
                ++chunks_running_;
                if (streams_tiles()) work->task.reply_bytes_max = work->chunk.count * tile_bytes;
                return std::move(work->task);
            }
            return std::nullopt;
        case Stage::exposing:
            if (std::exchange(task_started_, true)) return std::nullopt;
            return exposure_task();
        case Stage::encoding:
            if (std::exchange(task_started_, true)) return std::nullopt;
            return encode_task();
        case Stage::sending:
            return payload().next();
        case Stage::receiving:
            return copies_.next();
        case Stage::finished:
            break;
    }
    return std::nullopt;
}

Reply<void> FilmJob::ended() {
    task_started_ = false;
    switch (stage_) {
        case Stage::preparing:
            began_ = Clock::now();
            settled_before_ = tiles_->settled();
            begin_pass();
            break;
        case Stage::tracing:
            --chunks_running_;
            if (chunks_running_ == 0 && queue_.answered() == (pass_ + 1) * tile_count_) go_on();
            break;
        case Stage::exposing:
            trace_pass();
            break;
        case Stage::encoding:
            stage_ = Stage::sending;
            break;
        case Stage::sending:
            payload().ended();
            if (payload().finished()) go_on();
            break;
        case Stage::receiving:
            copies_.ended();
            end_receiving();
            break;
        case Stage::finished:
            break;
    }
    return {};
}

void FilmJob::go_on() {
    if (stage_ == Stage::sending) {
        stage_ = Stage::finished;
        if (final_) return;
    } else {
        final_ = is_last_pass() || overdue() || tiles_->settled() == tiles_->total();
        if (final_ || shows_pass()) {
            stage_ = Stage::encoding;
            return;
        }
    }
    ++pass_;
    begin_pass();
}

void FilmJob::begin_pass() {
    if (streams_tiles() && pass_ == 1)
        stage_ = Stage::exposing;
    else
        trace_pass();
}

Task FilmJob::exposure_task() {
    Task task;
    task.run = [this](const Stop&) {
        preview_stops_ = auto_exposure(*film_);
        return Reply<Frames>(Frames{});
    };
    return task;
}

void FilmJob::trace_pass() {
    stage_ = Stage::tracing;
    queue_.add(pass_ * tile_count_, tile_count_);
}

bool FilmJob::finished() const {
    return stage_ == Stage::finished;
}

bool FilmJob::streams_tiles() const {
    return options_.streams_tiles && is_last_pass();
}

bool FilmJob::shows_pass() {
    if (plan_.detach) {
        const Clock::time_point now = Clock::now();
        if (now - std::max(shown_, began_) < kept_every) return false;
        shown_ = now;
        return true;
    }
    return options_.progressive;
}

std::optional<Progress> FilmJob::progress() const {
    Progress progress;
    switch (stage_) {
        case Stage::receiving:
            return Progress{resumed_.received() + environment_.received(),
                            options_.resume_bytes + options_.environment_bytes, "uploading"};
        case Stage::preparing:
            return Progress{0, 0, "preparing"};
        case Stage::encoding:
            progress.stage = "encoding";
            break;
        case Stage::sending:
        case Stage::finished:
            progress.stage = "sending";
            break;
        case Stage::tracing:
        case Stage::exposing:
            progress.stage = "tracing";
            break;
    }
    progress.done = tiles_->settled();
    progress.total = tiles_->total();
    progress.samples = fewest_;
    progress.noise = noise_;
    const std::uint64_t made = progress.done - std::min(progress.done, settled_before_);
    if (made == 0) return progress;
    using Milliseconds = std::chrono::duration<double, std::milli>;
    const Clock::time_point now = Clock::now();
    double left = Milliseconds(now - began_).count() / static_cast<double>(made) *
                  static_cast<double>(progress.total - progress.done);
    if (best_by_ != Clock::time_point::max())
        left = std::clamp(Milliseconds(best_by_ - now).count(), 0.0, left);
    progress.left_ms = static_cast<std::uint64_t>(left);
    return progress;
}

void FilmJob::look_at_tiles(Clock::time_point now) {
    Clock::time_point due = looked_;
    if (now < due + look_every || !looked_.compare_exchange_strong(due, now)) return;
    fewest_ = tiles_->fewest();
    noise_ = tiles_->noise();
}

Task FilmJob::film_task() {
    Task task;
    // It waits for the process that decodes.
    if (options_.environment_bytes + options_.resume_bytes != 0) task.pool = &services_.blocking;
    task.run = [this](const Stop& stop) -> Reply<Frames> {
        if (stop.requested()) return refuse(Code::cancelled, "");
        if (const auto done = make_film(stop); !done) return tl::unexpected(done.error());
        return Frames{};
    };
    return task;
}

Reply<void> FilmJob::make_film(const Stop& stop) {
    const ImageSize size{request().width, request().height};
    film_.emplace(size, [&] { return !stop.requested(); });
    tiles_.emplace(size, options_.samples, options_.noise);
    if (stop.requested()) return refuse(Code::cancelled, "");
    IntegratorSettings settings = options_.settings;
    if (options_.environment_bytes != 0) {
        environment_hash_ = std::to_string(protocol::upload_checksum(environment_.bytes()));
        auto picture = read_environment(services_, principal_, environment_.bytes(), stop);
        if (!picture) return tl::unexpected(picture.error());
        settings.picture = std::move(*picture);
        environment_.drop();
    }
    auto made =
        make_integrator(options_.integrator,
                        {plan_.source(services_.registry), plan_.scene.snapshot().framed_bounds(),
                         &plan_.scene.snapshot().shading(),
                         services_.registry.packs().front()->target, &plan_.view(), plan_.mask},
                        settings);
    if (!made) return refuse(made.error());
    integrator_ = std::move(*made);
    if (options_.resume_bytes == 0) return {};

    if (auto read = read_film(services_, principal_, resumed_.bytes(), all_attributes(),
                              options_.samples, stop, *film_);
        !read)
        return read;
    resumed_.drop();
    if (!tiles_->restore(*film_))
        return refuse(Code::invalid_field,
                      "the EXR to continue is damaged: pixels of one tile of 64x8 have different "
                      "numbers of samples");
    return {};
}

std::uint64_t FilmJob::chunk_size(const Backend& backend, const Chunk& rest) const {
    const std::uint64_t samples_max = backend.call_rays_max(plan_);
    const std::uint32_t target = options_.passes[rest.first / tile_count_];
    const auto most =
        static_cast<std::uint32_t>(std::max<std::uint64_t>(1, samples_max / FilmTiles::pixels_max));
    const std::uint64_t tile = rest.first % tile_count_;
    const std::uint32_t next = std::max(1U, tiles_->next_samples(tile, target, most));
    return std::max<std::uint64_t>(1, samples_max / (FilmTiles::pixels_max * next));
}

FilmJob::Run FilmJob::run_at(std::uint64_t tile, std::uint64_t end, std::uint32_t target,
                             std::uint64_t samples_max) const {
    const auto most =
        static_cast<std::uint32_t>(std::max<std::uint64_t>(1, samples_max / FilmTiles::pixels_max));
    Run run{tile, 1, tiles_->next_samples(tile, target, most)};
    std::uint64_t pixels = tiles_->pixels(tile);
    while (run.samples != 0 && tile + run.count < end) {
        const std::uint64_t next = tile + run.count;
        pixels += tiles_->pixels(next);
        if (tiles_->taken(next) != tiles_->taken(tile) ||
            tiles_->next_samples(next, target, most) != run.samples ||
            pixels * run.samples > samples_max)
            break;
        ++run.count;
    }
    return run;
}

Traced<Frames> FilmJob::trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) {
    const std::uint64_t base = chunk.first - chunk.first % tile_count_;
    const std::uint32_t target = options_.passes[chunk.first / tile_count_];
    const std::uint64_t samples_max = queue_.backend_of(chunk).call_rays_max(plan_);
    const std::uint64_t end = chunk.first + chunk.count - base;
    ChunkCaster caster(plans(), chunk.backend, stop, buffers);
    CountingCaster counting(caster);
    WavefrontPointer wavefront = take_wavefront();
    Frames frames;
    std::vector<Chunk> rest;
    std::uint64_t done = 0;
    for (std::uint64_t tile = chunk.first - base; tile < end;) {
        const Run run = run_at(tile, end, target, samples_max);
        if (run.samples != 0 && overdue()) {
            // The picture is finished with the samples it has.
            done += end - tile;
            break;
        }
        tile += run.count;
        if (run.samples == 0) {
            ++done;
            continue;
        }
        SampleRange range{sensor(),
                          tiles_->first_pixel(run.tile),
                          0,
                          tiles_->taken(run.tile),
                          run.samples,
                          options_.seed,
                          request().window};
        for (std::uint64_t i = 0; i < run.count; ++i)
            range.pixel_count += tiles_->pixels(run.tile + i);
        // Samples that were added before a failure stay: the counts of tiles say what is left to
        // do.
        if (!add_samples(*integrator_, range, counting, *wavefront, *film_))
            return tl::unexpected(caster.failure());
        for (std::uint64_t one = run.tile; one < run.tile + run.count; ++one) {
            tiles_->add(one, run.samples, *film_);
            if (tiles_->next_samples(one, target, 1) != 0) {
                rest.push_back({base + one, 1, chunk.backend});
                continue;
            }
            ++done;
            if (!streams_tiles()) continue;
            auto frame = tile_frame(one);
            if (!frame) return tl::unexpected(frame.error());
            frames.push_back(std::move(*frame));
        }
    }
    if (counting.counts.rays != 0)
        statistics_.add(chunk.backend, caster.traversal(), counting.counts);
    count_rays("film", chunk, counting.counts.rays);
    // Backwards, because each goes to the front: the first tile is finished first.
    for (auto one = rest.rbegin(); one != rest.rend(); ++one) queue_.give_back(*one);
    queue_.answered(done);
    look_at_tiles(Clock::now());
    give_back(std::move(wavefront));
    return frames;
}

Reply<protocol::Frame> FilmJob::tile_frame(std::uint64_t tile) const {
    const Window window = tiles_->window(tile);
    const float stops = options_.look.exposure ? *options_.look.exposure : preview_stops_;
    const Picture picture = show(*film_, window, options_.look.tonemap, stops);
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, picture.rgba.size());
    bulk.allocate();
    std::memcpy(bulk.block(0).data(), picture.rgba.data(), picture.rgba.size());
    wire::PayloadT message;
    message.width = window.width;
    message.height = window.height;
    message.x = window.x;
    message.y = window.y;
    message.encode = request().encode;
    message.total = picture.rgba.size();
    message.samples = tiles_->taken(tile);
    message.last = false;
    return protocol::encode(id_, std::move(message), std::move(bulk), services_.limits);
}

Reply<Payload> FilmJob::encode() {
    if (tiles_->most() == 0) {
        protocol::Error late = deadline_error();
        late.message =
            "not one sample was made by then; allow more time, or ask for a smaller "
            "`size`";
        return tl::unexpected(late);
    }
    auto payload = encode_film(*film_, request().encode, options_.look, all_attributes());
    if (!payload) return payload;
    payload->samples = fewest_ = tiles_->fewest();
    noise_ = tiles_->noise();
    payload->last = final_;
    return payload;
}

std::vector<Attribute> FilmJob::all_attributes() const {
    std::vector<Attribute> attributes = provenance();
    attributes.insert(attributes.end(), options_.attributes.begin(), options_.attributes.end());
    if (!environment_hash_.empty())
        attributes.push_back({"raynest:environment_hash", environment_hash_});
    return attributes;
}

void FilmJob::complete(wire::DoneT& done) const {
    done.samples = tiles_->fewest();
    done.noise = tiles_->noise();
    done.dropped = film_->dropped();
    done.incomplete = tiles_->settled() < tiles_->total();
    if (integrator_ == nullptr) return;
    for (std::string& note : light_notes(*integrator_, plan_.scene.snapshot(), services_.limits))
        done.notes.push_back(std::move(note));
    if (done.incomplete) {
        std::uint64_t samples = 0;
        for (std::uint64_t tile = 0; tile < tile_count_; ++tile)
            samples += tiles_->pixels(tile) * tiles_->taken(tile);
        done.notes.push_back(
            "pixels have " + std::to_string(tiles_->fewest()) + " to " +
            std::to_string(tiles_->most()) + " of " + std::to_string(options_.samples) +
            " samples, " +
            rounded(static_cast<double>(samples) / static_cast<double>(request().pixels())) +
            " on average");
    } else if (const std::uint64_t noisy = tiles_->noisy(); noisy != 0) {
        done.notes.push_back(
            "the error is still above `noise` " + rounded(static_cast<double>(options_.noise)) +
            " in " + std::to_string(noisy) + " of " + std::to_string(tile_count_) +
            " parts of the picture, " + rounded(static_cast<double>(tiles_->noise())) +
            " in all of it: ask for more `samples` than " + std::to_string(options_.samples));
    }
    if (done.dropped != 0)
        done.notes.push_back(std::to_string(done.dropped) +
                             " samples were not finite and count for nothing; the layer dropped "
                             "of an EXR shows where");
}

FilmJob::WavefrontPointer FilmJob::take_wavefront() {
    const std::lock_guard lock(mutex_);
    if (idle_.empty()) return std::make_unique<Wavefront>();
    WavefrontPointer wavefront = std::move(idle_.back());
    idle_.pop_back();
    return wavefront;
}

void FilmJob::give_back(WavefrontPointer wavefront) {
    const std::lock_guard lock(mutex_);
    idle_.push_back(std::move(wavefront));
}

}  // namespace raynest::server
