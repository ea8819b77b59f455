/* What the host calls, by the names and in the layout of the component model's canonical ABI. Nothing of it allocates: what the host hands over
 * lies in one arena, which is empty again when a call ends. */
#include "holdpoint_skill.h"

#ifndef HOLDPOINT_ARENA_BYTES
#define HOLDPOINT_ARENA_BYTES 32768
#endif

_Static_assert(sizeof(holdpoint_pose) == 56, "pose");
_Static_assert(sizeof(holdpoint_object) == 72, "seen-object");
_Static_assert(sizeof(holdpoint_reading) == 20, "named-vector");
_Static_assert(offsetof(holdpoint_observation, objects) == 160, "observation");
_Static_assert(offsetof(holdpoint_observation, sensors) == 176, "observation");
_Static_assert(offsetof(holdpoint_observation, task) == 188, "observation");
_Static_assert(offsetof(holdpoint_observation, guard) == 212, "observation");
_Static_assert(sizeof(holdpoint_observation) == 216, "observation");
_Static_assert(offsetof(holdpoint_command, tool_pose) == 8, "command");
_Static_assert(sizeof(holdpoint_command) == 72, "command");
_Static_assert(sizeof(holdpoint_sensor) == 12, "vector-spec");
_Static_assert(sizeof(holdpoint_description) == 32, "description");
_Static_assert(sizeof(holdpoint_parameter) == 24, "parameter");

static _Alignas(8) uint8_t arena[HOLDPOINT_ARENA_BYTES];
static uint32_t arena_used;

#define EXPORT(name) __attribute__((export_name(name)))
#define SKILL "holdpoint:skill/skill@2.0.0#"

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
            holdpoint_description description;
            holdpoint_text error;
        };
    } said;
    holdpoint_description description = { 0 };
    holdpoint_text error = skill_describe((holdpoint_parameters){ all, count }, &description);
    said.is_error = error.bytes != 0;
    if (said.is_error)
        said.error = error;
    else
        said.description = description;
    arena_used = 0;
    return &said;
}

EXPORT(SKILL "start") void *holdpoint_start(uint64_t seed, const holdpoint_parameter *all, uint32_t count,
    const void *images, uint32_t image_count, const holdpoint_sensor *sensors, uint32_t sensor_count)
{
    static struct {
        uint8_t is_error;
        holdpoint_text error;
    } said;
    /* Every sensor that is asked for is granted, or the component does not run. */
    (void)images, (void)image_count, (void)sensors, (void)sensor_count;
    said.error = skill_start(seed, (holdpoint_parameters){ all, count });
    said.is_error = said.error.bytes != 0;
    arena_used = 0;
    return &said;
}

EXPORT(SKILL "step") void *holdpoint_step(const holdpoint_observation *seen)
{
    static holdpoint_command commands[HOLDPOINT_COMMANDS_MAX];
    static struct {
        const holdpoint_command *all;
        uint32_t count;
    } answer = { commands, 0 };
    commands[0].kind = HOLDPOINT_HOLD;
    answer.count = skill_step(seen, commands);
    arena_used = 0;
    return &answer;
}

EXPORT(SKILL "enter") void holdpoint_enter(uint32_t hook)
{
    skill_enter((uint8_t)hook);
}

static bool equal(holdpoint_text one, holdpoint_text other)
{
    uint32_t n = 0;
    while (n < one.length && n < other.length && one.bytes[n] == other.bytes[n])
        n++;
    return n == one.length && n == other.length;
}

const holdpoint_estimate *holdpoint_named(const holdpoint_observation *seen, holdpoint_text name)
{
    for (uint32_t i = 0; i < seen->object_count; i++)
        if (equal(seen->objects[i].name, name))
            return &seen->objects[i].at;
    return 0;
}

const holdpoint_reading *holdpoint_measured(const holdpoint_observation *seen, holdpoint_text name)
{
    for (uint32_t i = 0; i < seen->sensor_count; i++)
        if (equal(seen->sensors[i].name, name))
            return &seen->sensors[i];
    return 0;
}

bool holdpoint_number(holdpoint_parameters parameters, const char *name, double *value)
{
    holdpoint_text wanted = { name, 0 };
    while (name[wanted.length])
        wanted.length++;
    for (uint32_t i = 0; i < parameters.count; i++) {
        const holdpoint_parameter *one = &parameters.all[i];
        if (equal(one->name, wanted) && one->kind == HOLDPOINT_NUMBER) {
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
