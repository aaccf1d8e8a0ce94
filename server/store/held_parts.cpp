#include "server/store/held_parts.h"

#include "engine/assets/formats/part_file.h"

#include <algorithm>
#include <cstring>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>

namespace raynest::server {
namespace {

class Search {
public:
    Search(std::span<const WantedFile> wanted, const std::function<bool(std::uint64_t)>& reserve,
           const Stop& stop)
        : wanted_(wanted),
          reserve_(reserve),
          stop_(stop),
          found_(wanted.size()) {
        constexpr std::uint64_t hashed_share_max = 4;
        for (std::size_t i = 0; i < wanted.size(); ++i) {
            if (wanted[i].digest == nullptr || wanted[i].into.empty()) continue;
            missing_.emplace(wanted[i].into.size(), i);
            left_ += hashed_share_max * wanted[i].into.size();
        }
    }

    void look_at(const SceneView& view) {
        for (std::uint32_t i = 0; i < view.object_count && !missing_.empty(); ++i) {
            if (stop_.requested()) return;
            for (const PartFile& file : part_files(view, view.objects[i])) look_at(file);
        }
    }

    [[nodiscard]] std::vector<bool> found() && { return std::move(found_); }

private:
    void look_at(const PartFile& file) {
        const std::uint64_t bytes = file.bytes();
        if (!missing_.contains(bytes) || bytes > left_) return;
        if (!hashed_.emplace(bytes, file.sample()).second) return;
        left_ -= bytes;
        protocol::Sha256 sum;
        file.write([&](std::span<const std::byte> piece) {
            sum.add(piece);
            return !stop_.requested();
        });
        const auto digest = sum.digest();
        const auto [first, last] = missing_.equal_range(bytes);
        for (auto at = first; at != last && digest && !stop_.requested();) {
            if (*wanted_[at->second].digest != *digest) {
                ++at;
                continue;
            }
            if (reserve_(bytes)) fill_in(file, at->second);
            at = missing_.erase(at);
        }
    }

    void fill_in(const PartFile& file, std::size_t index) {
        std::byte* to = wanted_[index].into.data();
        file.write([&](std::span<const std::byte> piece) {
            std::ranges::copy(piece, to);
            to += piece.size();
            return true;
        });
        found_[index] = true;
    }

    const std::span<const WantedFile> wanted_;
    const std::function<bool(std::uint64_t)>& reserve_;
    const Stop& stop_;
    std::vector<bool> found_;
    std::unordered_multimap<std::uint64_t, std::size_t> missing_;  ///< by length
    std::set<std::pair<std::uint64_t, std::string>> hashed_;       ///< PartFile::sample(), too
    std::uint64_t left_ = 0;  ///< bytes that may still be hashed
};

}  // namespace

std::vector<bool> fill_in_held_parts(std::span<const std::shared_ptr<const HeldScene>> scenes,
                                     std::span<const WantedFile> wanted,
                                     const std::function<bool(std::uint64_t)>& reserve,
                                     const Stop& stop) {
    Search search(wanted, reserve, stop);
    for (const auto& scene : scenes) search.look_at(scene->snapshot->view());
    return std::move(search).found();
}

}  // namespace raynest::server
