// The stream traversal: many rays in flight, one step of each in turn.
//
// Incoherent rays wait for memory and for mispredicted branches, not for arithmetic. Here sixteen
// rays take turns: by the time one is looked at again, the node that it asked for has arrived, and
// its step has no branch that depends on data (children are sorted by the octant's order, packed
// and stored as a whole; a ray is appended to every list and only the counters say to which).
// Measured against the single traversal, which looks at several nodes together, for incoherent
// rays of one large tree: rays from anywhere 1.5 to 1.7, from near by 0.9 to 1.2, indoors 0.7
// to 1.0. Below instances 0.65 to 1.0, coherent rays 0.75 to 0.97 (packs/kernel_selector.cpp
// chooses).
//
// All rays push the children of their nodes before the first of them pops what it looks at next. A
// pop waits for the end of the ray's box test; done at once, it and its prefetches fill the CPU's
// schedulers, and the tests of the next rays start late (measured: 1.05 to 1.1 times as fast).
//
// Levels: entering an instance saves the parent's ray and pushes a sentinel; popping the sentinel
// restores it. Depth costs memory, never recursion.
#pragma once

#include "engine/bvh/cancellation.h"
#include "engine/bvh/tree_arrays.h"
#include "engine/bvh/visit.h"
#include "engine/math/compact.h"

#include <cstddef>
#include <cstdint>
#include <limits>
#include <new>
#include <utility>

namespace raynest {

inline constexpr std::uint32_t stream_width =
    16;  ///< rays in flight; 8 to 24 are equal, 32 leaves L1

/// One ray in flight.
template <class Query>
struct StreamRay {
    BoxRay* levels;  ///< the ray at every level down to where it is
    BoxRay* ray;     ///< the last of them
    Query query;
    TreeArrays arrays;        ///< the arrays of the ray's object
    std::uint32_t* children;  ///< the stack: child words,
    float* nears;             ///< and where the ray enters them; of ordered queries only
    std::uint32_t top;        ///< entries in use
    std::uint32_t child;      ///< what is looked at next
    std::uint32_t far_first;  ///< shift of Node::order that sorts farthest first
    std::uint32_t index;      ///< the io's number of the ray
};

template <class Isect, class TraceIO>
class StreamTraversal {
    using Query = typename TraceIO::Query;
    using Ray = StreamRay<Query>;
    // Packing writes eight entries behind the top.
    static constexpr std::size_t stack_of_level = 7 * tree_height_max + 8;

public:
    StreamTraversal(const Bvh& root, Isect& isect, const TraceIO& io)
        : root_(root),
          isect_(isect),
          io_(io) {}

    /// False when there is no memory for the stacks.
    bool trace(std::uint32_t count) {
        const std::size_t levels = root_.record().levels;
        const std::size_t stack = stack_of_level * levels + 8;
        const std::size_t bytes =
            sizeof(BoxRay) * levels + (sizeof(std::uint32_t) + sizeof(float)) * stack;
        // An odd number of cache lines: all rays' stacks begin in cache sets of their own.
        constexpr std::size_t line = 64;
        const std::size_t each = ((bytes + line - 1) / line | 1) * line;
        constexpr std::align_val_t alignment{line};
        void* memory = ::operator new(each* stream_width, alignment, std::nothrow);
        if (memory == nullptr) return false;
        auto* at = static_cast<std::byte*>(memory);
        for (StreamRay<Query>& flight : flights_) {
            flight.levels = reinterpret_cast<BoxRay*>(at);
            flight.children = reinterpret_cast<std::uint32_t*>(at + sizeof(BoxRay) * levels);
            flight.nears = reinterpret_cast<float*>(flight.children + stack);
            at += each;
        }
        run(count);
        ::operator delete(memory, alignment);
        return true;
    }

private:
    void run(std::uint32_t count) {
        next_ = 0;
        count_ = count;
        inner_count_ = leaf_count_ = 0;
        for (Ray& flight : flights_) {
            if (!launch(flight)) break;
            advance(flight);
        }
        constexpr std::uint32_t few = stream_width / 2;
        constexpr std::uint32_t round_work = 8 * stream_width;  // for leaves, which are not counted
        while (inner_count_ + leaf_count_ != 0 && !is_cancelled(io_.cancellation, round_work)) {
            if (inner_count_ != 0 && leaf_count_ < few) {
                const std::uint32_t standing = std::exchange(inner_count_, 0);
                for (std::uint32_t i = 0; i < standing; ++i) step(*inner_[i]);
                for (std::uint32_t i = 0; i < standing; ++i) advance(*inner_[i]);
            } else {
                const std::uint32_t standing = std::exchange(leaf_count_, 0);
                for (std::uint32_t i = 0; i < standing; ++i) {
                    Ray& flight = *leaf_[i];
                    if (answer_leaf(flight)) {
                        io_.end(flight.index, flight.query);
                        if (!launch(flight)) continue;
                    }
                    advance(flight);
                }
            }
        }
    }

    /// Puts the next ray that needs tracing into a slot.
    bool launch(Ray& flight) {
        while (next_ < count_) {
            flight.index = next_++;
            RayView view;
            if (!io_.begin(flight.index, view)) continue;
            flight.query = io_.query(flight.index);
            flight.ray = new (flight.levels) BoxRay(view);
            flight.top = 0;
            enter_tree(flight);
            return true;
        }
        return false;
    }

    /// The root of the ray's object is what it looks at next; beneath it lies a sentinel.
    static void enter_tree(Ray& flight) {
        use_object(flight);
        push(flight, child_empty);
        if (flight.ray->object->root != child_empty) push(flight, flight.ray->object->root);
    }
    static void push(Ray& flight, std::uint32_t child) {
        flight.children[flight.top] = child;
        flight.nears[flight.top++] = -std::numeric_limits<float>::infinity();
    }

    static void use_object(Ray& flight) {
        const BoxRay& ray = *flight.ray;
        flight.arrays = TreeArrays(*ray.scene, *ray.object);
        flight.far_first = far_first(ray);
    }

    /// Pushes the children of the node that the ray stands at.
    RAYNEST_INLINE void step(Ray& flight) {
        const Node& node = flight.arrays.node(flight.child);
        const auto spans = intersect_with(isect_, *flight.ray, Boxes8{&node});
        const std::uint32_t top = flight.top;
        if constexpr (Query::ordered && !Overrides<Isect, BoxRay, Boxes8>) {
            flight.top =
                top + pack_ordered(spans.near, spans.leaves, node.child, node.valid(), node.order,
                                   flight.far_first, flight.nears + top, flight.children + top);
        } else if constexpr (Query::ordered) {
            flight.top =
                top + pack_ordered(spans.near, node.child, spans.mask, node.order, flight.far_first,
                                   flight.nears + top, flight.children + top);
        } else {
            flight.top = top + pack_words(node.child, spans.mask, flight.children + top);
        }
    }

    /// Pops what the ray looks at next, and appends it to the rays that stand at the same kind.
    ///
    /// The sentinel is never behind the best hit, so the stack needs no test for its end. The first
    /// hit ends a query that is not ordered: nothing of its stack is ever behind.
    RAYNEST_INLINE void advance(Ray& flight) {
        std::uint32_t top = flight.top - 1;
        if constexpr (Query::ordered) {
            while (flight.nears[top] > flight.ray->tmax) --top;
        }
        flight.top = top;
        const TreeArrays arrays = flight.arrays;
        const std::uint32_t child = flight.children[top];
        flight.child = child;
        arrays.prefetch(child);
        const std::uint32_t leaf = child >> 31;
        inner_[inner_count_] = &flight;
        inner_count_ += 1 - leaf;
        leaf_[leaf_count_] = &flight;
        leaf_count_ += leaf;
    }

    /// Answers what the ray stands at; true when the ray's query is answered.
    bool answer_leaf(Ray& flight) {
        const std::uint32_t child = flight.child;
        if (child == child_empty) {
            if (flight.ray == flight.levels) return true;
            const float tmax = flight.ray->tmax;
            --flight.ray;
            flight.ray->tmax = tmax;
            use_object(flight);
            return false;
        }
        switch (kind_of(child)) {
            case ChildKind::triangles: {
                const TriangleBlock* block = flight.arrays.blocks(child);
                const TriangleBlock* const end = block + leaf_count(child);
                bool first = true;
                for (; block != end; ++block, first = false) {
                    if (visit(*flight.ray, Triangles8{block, first}, isect_, flight.query))
                        return true;
                }
                return false;
            }
            case ChildKind::records: {
                const auto& ray = *flight.ray;
                return visit_record_type(*ray.scene, *ray.object, leaf_first(child),
                                         leaf_count(child), [&](const auto& record) {
                                             return visit(*flight.ray, record, isect_,
                                                          flight.query);
                                         });
            }
            case ChildKind::instance: {
                const SceneView& scene = *flight.ray->scene;
                const Instance instance{&scene,
                                        flight.ray->object->first_instance + leaf_instance(child)};
                const InstanceRecord& record = instance.record();
                if ((record.mask & flight.ray->mask) == 0 || !enters(isect_, *flight.ray, instance))
                    return false;
                flight.ray = new (flight.ray + 1) BoxRay(enter(*flight.ray, scene, record));
                enter_tree(flight);
                return false;
            }
        }
        return false;
    }

    const Bvh root_;
    Isect& isect_;
    const TraceIO& io_;
    std::uint32_t next_ = 0, count_ = 0;
    StreamRay<Query> flights_[stream_width];
    // One place more, because appending writes before it counts.
    Ray* inner_[stream_width + 1];
    Ray* leaf_[stream_width + 1];
    std::uint32_t inner_count_ = 0, leaf_count_ = 0;
};

}  // namespace raynest
