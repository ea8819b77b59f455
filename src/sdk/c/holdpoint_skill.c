/* What the host calls, by the names and in the layout of the component model's canonical ABI. Nothing of it allocates: what the host hands over
 * lies in one arena, which is empty again when a call ends. */
#include "holdpoint_skill.h"

#ifndef HOLDPOINT_ARENA_BYTES
#define HOLDPOINT_ARENA_BYTES 32768
#endif

_Static_assert(sizeof(holdpoint_joints) == 72, "joints");
_Static_assert(sizeof(holdpoint_pose) == 56, "pose");
_Static_assert(sizeof(holdpoint_seen) == 72, "option<estimate>");
_Static_assert(offsetof(holdpoint_observation, object) == 352, "observation");
_Static_assert(offsetof(holdpoint_observation, guard) == 498, "observation");
_Static_assert(sizeof(holdpoint_observation) == 504, "observation");
_Static_assert(offsetof(holdpoint_command, tool_pose) == 8, "command");
_Static_assert(sizeof(holdpoint_command) == 88, "command");
_Static_assert(sizeof(holdpoint_parameter) == 24, "parameter");

static _Alignas(8) uint8_t arena[HOLDPOINT_ARENA_BYTES];
static uint32_t arena_used;

#define EXPORT(name) __attribute__((export_name(name)))
#define SKILL "holdpoint:skill/skill@1.0.0#"

EXPORT("cabi_realloc") void *holdpoint_realloc(void *old, uint32_t old_bytes, uint32_t align, uint32_t bytes)
{
    uint32_t at = (arena_used + align - 1) & ~(align - 1);
    (void)old;
    (void)old_bytes; /* the host makes nothing larger that it made before */
    if (at > sizeof arena || bytes > sizeof arena - at)
        __builtin_trap();
    arena_used = at + bytes;
    return arena + at;
}

EXPORT(SKILL "describe") void *holdpoint_describe(const holdpoint_parameter *all, uint32_t count)
{
    static struct {
        uint8_t is_error;
        union {
            struct {
                uint8_t task;
                holdpoint_text interface;
            } description;
            holdpoint_text error;
        };
    } said;
    uint8_t task = HOLDPOINT_GRASP;
    holdpoint_text interface = { 0, 0 };
    holdpoint_text error = skill_describe((holdpoint_parameters){ all, count }, &task, &interface);
    said.is_error = error.bytes != 0;
    if (said.is_error) {
        said.error = error;
    } else {
        said.description.task = task;
        said.description.interface = interface;
    }
    arena_used = 0;
    return &said;
}

EXPORT(SKILL "start") void *holdpoint_start(uint64_t seed, const holdpoint_parameter *all, uint32_t count)
{
    static struct {
        uint8_t is_error;
        holdpoint_text error;
    } said;
    said.error = skill_start(seed, (holdpoint_parameters){ all, count });
    said.is_error = said.error.bytes != 0;
    arena_used = 0;
    return &said;
}

EXPORT(SKILL "tick") void *holdpoint_tick(const holdpoint_observation *seen)
{
    static holdpoint_command command;
    command.kind = HOLDPOINT_HOLD;
    skill_tick(seen, &command);
    arena_used = 0;
    return &command;
}

EXPORT(SKILL "enter") void holdpoint_enter(uint32_t hook)
{
    skill_enter((uint8_t)hook);
}

bool holdpoint_number(holdpoint_parameters parameters, const char *name, double *value)
{
    for (uint32_t i = 0; i < parameters.count; i++) {
        const holdpoint_parameter *one = &parameters.all[i];
        uint32_t n = 0;
        while (n < one->name.length && name[n] && name[n] == one->name.bytes[n])
            n++;
        if (n == one->name.length && !name[n] && one->kind == HOLDPOINT_NUMBER) {
            *value = one->number;
            return true;
        }
    }
    return false;
}

/* What the compiler may call where it copies a struct. */
void *memcpy(void *to, const void *from, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++)
        ((volatile uint8_t *)to)[i] = ((const uint8_t *)from)[i];
    return to;
}

void *memset(void *to, int value, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++)
        ((volatile uint8_t *)to)[i] = (uint8_t)value;
    return to;
}
