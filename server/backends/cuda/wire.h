// The messages between the daemon and its device worker: fixed size, one at a time per socket. Both
// are the same program, so there is no version. After a message of the wrong size the socket counts
// as closed.
//
//   control:    Hello, memory and a socket per slot ──►   ◄── Ready
//   each slot:  Request (with a memory file, to load or load_changed) ──►   ◄── Outcome
//
// Rays and answers lie in memory that both map; each slot has a part:  rays | hits | hit counts
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/pinhole.h"
#include "engine/packs/abi.h"
#include "protocol/hash.h"

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>

namespace raynest::server::device {

inline constexpr std::uint32_t slots_max = 8;
inline constexpr std::uint32_t variants_max = 64;
inline constexpr std::uint32_t params_max = 32;
inline constexpr std::uint32_t record_types_max = 32;

/// Zero-terminated text of at most N - 1 bytes; longer text is truncated.
template <std::size_t N>
struct Text {
    char chars[N] = {};

    Text() = default;
    explicit Text(std::string_view text) {
        std::memcpy(chars, text.data(), text.size() < N ? text.size() : N - 1);
    }
    [[nodiscard]] std::string_view view() const { return {chars, strnlen(chars, N)}; }
    /// Returns the text for messages; non-printable characters, e.g. of a driver, become '?'.
    [[nodiscard]] std::string printable() const {
        std::string text(view());
        for (char& c : text)
            if (c < ' ' || c > '~') c = '?';
        return text;
    }
};

/// Maximum rays and hits of a slot, and the layout of its memory.
struct SlotShape {
    std::uint64_t rays_max = 0;
    std::uint64_t hits_max = 0;

    [[nodiscard]] std::size_t hits_at() const { return rays_max * sizeof(Ray); }
    [[nodiscard]] std::size_t counts_at() const { return hits_at() + hits_max * sizeof(HitRecord); }
    /// Bytes of a slot's memory, rounded up to whole pages.
    [[nodiscard]] std::size_t bytes() const {
        constexpr std::size_t page = 4096;
        return (counts_at() + rays_max * sizeof(std::uint32_t) + page - 1) / page * page;
    }
};

/// Returns a hash of a variant's parameters: names, types and choices in order. Values of a call
/// mean the same for variants with equal fingerprints.
[[nodiscard]] inline std::uint64_t fingerprint(std::span<const PackParam> params) {
    std::string text;
    for (const PackParam& param : params) {
        text += std::string(param.name) + ' ' + std::to_string(param.type);
        for (std::uint32_t i = 0; i < param.choice_count; ++i)
            text += std::string(" ") + param.choices[i];
        text += '\n';
    }
    return protocol::upload_checksum(std::as_bytes(std::span(text)));
}

/// The part of the shared memory that belongs to a slot.
struct SlotMemory {
    Ray* rays;
    HitRecord* hits;
    std::uint32_t* hit_counts;

    SlotMemory(std::byte* memory, const SlotShape& shape, std::uint32_t slot) {
        std::byte* const at = memory + slot * shape.bytes();
        rays = reinterpret_cast<Ray*>(at);
        hits = reinterpret_cast<HitRecord*>(at + shape.hits_at());
        hit_counts = reinterpret_cast<std::uint32_t*>(at + shape.counts_at());
    }
};

/// The daemon's first message. Carries the memory file and the slots' sockets, in this order.
struct Hello {
    pid_t parent = 0;
    std::uint32_t slots = 0;
    SlotShape shape;
};

struct VariantInfo {
    Text<64> name;
    std::uint32_t queries = 0;  ///< bit q: Query q
    std::uint64_t params = 0;   ///< fingerprint()
};

/// The worker's answer to Hello.
struct Ready {
    bool ok = false;
    bool absent = false;  ///< permanent failure: there is no device, or no pack for it
    Text<256> text;       ///< the device's name, or why it is not ok
    std::uint32_t variant_count = 0;
    VariantInfo variants[variants_max];
    std::uint32_t record_type_count = 0;
    std::uint32_t record_types[record_types_max] = {};
};

enum class Order : std::uint32_t {
    trace,
    load,         ///< uploads the arena in the attached memory file
    load_changed  ///< makes a scene of another one and of the changes in the file (scene_changes.h)
};

/// Names a scene's arena (Snapshot::arena_id()); zero-terminated.
using SceneText = Text<72>;

struct Request {
    Order order = Order::trace;
    SceneText scene;
    SceneText base;  ///< for Order::load_changed: a scene that the device holds

    // The rest is for Order::trace; the rays lie in the slot's memory.
    std::uint32_t variant = 0;  ///< index in Ready
    std::uint32_t query = 0;
    std::uint32_t ray_count = 0;
    std::uint32_t hits_max = 0;
    std::uint32_t mask = 0;
    std::uint32_t flags = 0;
    bool has_params = false;  ///< false: all parameters have their initial values
    bool has_made = false;    ///< the device generates the rays from `made`
    double params[params_max] = {};
    PinholeRays made;
};

enum class Verdict : std::uint32_t {
    done,
    unknown_scene,  ///< the device does not hold the scene; load it first
    out_of_memory,  ///< on the device or the host; the text says which
    too_deep,       ///< the scene is nested deeper than the kernels support
    refused,        ///< the request is invalid
    lost            ///< the device failed; the process must be replaced
};

struct Outcome {
    Verdict verdict = Verdict::refused;
    Text<256> text;
};

static_assert(std::is_trivially_copyable_v<Hello> && std::is_trivially_copyable_v<Ready> &&
              std::is_trivially_copyable_v<Request> && std::is_trivially_copyable_v<Outcome>);

}  // namespace raynest::server::device
