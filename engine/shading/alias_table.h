// Draws entries in proportion to their weights in constant time (Walker, 1977; built as Vose does).
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

class AliasTable {
public:
    AliasTable() = default;
    /// Weights are finite and not negative; without a positive one the table is empty.
    explicit AliasTable(std::span<const float> weights) {
        double sum = 0;
        for (const float w : weights) sum += static_cast<double>(w);
        if (!(sum > 0)) return;
        total_ = static_cast<float>(sum);
        slots_.resize(weights.size());
        std::vector<double> scaled(weights.size());
        std::vector<std::uint32_t> small, large;
        for (std::size_t i = 0; i < weights.size(); ++i) {
            scaled[i] = static_cast<double>(weights[i]) * static_cast<double>(weights.size()) / sum;
            (scaled[i] < 1 ? small : large).push_back(static_cast<std::uint32_t>(i));
        }
        while (!small.empty() && !large.empty()) {
            const std::uint32_t less = small.back();
            const std::uint32_t more = large.back();
            small.pop_back();
            slots_[less] = {static_cast<float>(scaled[less]), more};
            scaled[more] -= 1 - scaled[less];
            if (scaled[more] >= 1) continue;
            large.pop_back();
            small.push_back(more);
        }
        // Rounding leaves entries whose slot is full.
        for (const std::uint32_t i : small) slots_[i] = {scaled[i] > 0.5 ? 1.0F : 0.0F, 0};
        for (const std::uint32_t i : large) slots_[i] = {1, i};
        for (const std::uint32_t i : small)
            if (slots_[i].share == 0) slots_[i].other = large.empty() ? i : large.front();
    }

    [[nodiscard]] bool empty() const { return slots_.empty(); }
    [[nodiscard]] float total() const { return total_; }
    /// The entry for a number in [0, 1).
    [[nodiscard]] std::uint32_t draw(float u) const {
        const double place = static_cast<double>(u) * static_cast<double>(slots_.size());
        const auto slot = std::min(static_cast<std::size_t>(place), slots_.size() - 1);
        const double rest = place - static_cast<double>(slot);
        return rest < static_cast<double>(slots_[slot].share) ? static_cast<std::uint32_t>(slot)
                                                              : slots_[slot].other;
    }

private:
    struct Slot {
        float share = 1;
        std::uint32_t other = 0;
    };
    std::vector<Slot> slots_;
    float total_ = 0;
};

}  // namespace raynest
