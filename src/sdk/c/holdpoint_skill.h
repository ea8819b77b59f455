/* A skill in C: the messages of holdpoint:skill@2.0.0 (skill.wit), as they lie in a component's memory, and the four
 * functions that a skill defines. Compile holdpoint_skill.c along; it exports them under their names.
 *
 * Units are SI: metres, radians, newtons, seconds. Poses are in the world frame, z up, the robot's base at the origin. */
#ifndef HOLDPOINT_SKILL_H
#define HOLDPOINT_SKILL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Ticks per second. */
#define HOLDPOINT_RATE_HZ 240

/* The most commands of one answer. */
#define HOLDPOINT_COMMANDS_MAX 240

typedef struct {
    const char *bytes; /* UTF-8, without a zero at the end */
    uint32_t length;
} holdpoint_text;

/* A text in a literal. */
#define HOLDPOINT_TEXT(literal) ((holdpoint_text){ (literal), sizeof(literal) - 1 })

typedef struct {
    const double *values;
    uint32_t count;
} holdpoint_numbers;

typedef struct {
    double x, y, z;
} holdpoint_vector;

/* Of unit length. */
typedef struct {
    double x, y, z, w;
} holdpoint_quaternion;

typedef struct {
    holdpoint_vector position; /* m */
    holdpoint_quaternion rotation;
} holdpoint_pose;

typedef struct {
    holdpoint_vector linear;  /* m/s */
    holdpoint_vector angular; /* rad/s */
} holdpoint_twist;

/* Where the camera last saw something, and how long ago. */
typedef struct {
    holdpoint_pose pose; /* with noise and bias */
    uint32_t age_ticks;  /* since the picture was taken */
    uint32_t sequence;   /* counts the pictures: a new number is a new measurement */
} holdpoint_estimate;

/* An object that the camera saw, or a place for one. */
typedef struct {
    holdpoint_text name;
    holdpoint_estimate at;
} holdpoint_object;

/* The newest numbers of a sensor that the skill asked for. */
typedef struct {
    holdpoint_text name;
    uint32_t age_ticks; /* since they were measured */
    holdpoint_numbers values;
} holdpoint_reading;

/* No cell offers images. */
typedef struct {
    const void *all;
    uint32_t count;
} holdpoint_images;

/* What the guard did with the previous command. */
enum { HOLDPOINT_ALLOWED, HOLDPOINT_CLAMPED, HOLDPOINT_DENIED };

/* What a skill may see in one tick. */
typedef struct {
    uint64_t tick; /* since the task started */
    holdpoint_numbers q;   /* rad: one value per arm joint, base to tool */
    holdpoint_numbers dq;  /* rad/s */
    holdpoint_numbers tau; /* N m */
    holdpoint_pose tool;
    holdpoint_twist tool_twist;
    double gripper_width_m;
    double gripper_force_n; /* mean normal force on the pads */
    double wrist_force_n;   /* without the payload's weight */
    const holdpoint_object *objects; /* without those that are not in sight; see holdpoint_named */
    uint32_t object_count;
    holdpoint_images images;
    const holdpoint_reading *sensors; /* of those that it asked for, the ones that have numbers; see holdpoint_measured */
    uint32_t sensor_count;
    bool tool_available;
    /* What is to be done: the task, the name of the object on which it works, and that of the place for it. */
    holdpoint_text task, object, target;
    uint8_t guard; /* HOLDPOINT_ALLOWED, ... */
} holdpoint_observation;

/* Why a skill gives up. */
enum {
    HOLDPOINT_TARGET_NOT_FOUND,
    HOLDPOINT_GRASP_MISSED,
    HOLDPOINT_OBJECT_SLIPPED,
    HOLDPOINT_UNEXPECTED_CONTACT,
    HOLDPOINT_ALIGNMENT_LOST,
    HOLDPOINT_PLACEMENT_MISSED,
    HOLDPOINT_TOOL_UNAVAILABLE,
    HOLDPOINT_INPUT_STALE,
    HOLDPOINT_TIMED_OUT
};

enum {
    HOLDPOINT_HOLD,      /* leave both channels as they are */
    HOLDPOINT_TOOL_POSE, /* channel arm: the tool in a straight line to a pose */
    HOLDPOINT_JOINTS,    /* channel arm: the joints to a configuration */
    HOLDPOINT_GRIPPER,   /* channel gripper: the pads to a distance */
    HOLDPOINT_STOP,      /* channel arm: stand still as fast as the servo allows */
    HOLDPOINT_DONE,      /* the skill believes it has finished */
    HOLDPOINT_FAIL       /* the skill gives up */
};

/* What a skill may ask for in one tick. A setpoint stays in force until it is replaced. */
typedef struct {
    uint8_t kind; /* HOLDPOINT_HOLD, ... */
    union {
        struct {
            holdpoint_pose pose;
            double max_speed_m_s;
        } tool_pose;
        struct {
            holdpoint_numbers q; /* the values last until the answer is read: keep them in a static array */
            double max_speed_rad_s;
        } joints;
        struct {
            double width_m, speed_m_s, force_n;
        } gripper;
        uint8_t failure; /* HOLDPOINT_TARGET_NOT_FOUND, ... */
    };
} holdpoint_command;

/* Entry points beside the ordinary step: a standstill in a safe pose; or to where the predecessor can take over, then done. */
enum { HOLDPOINT_SAFE_ABORT, HOLDPOINT_ROLLBACK };

enum { HOLDPOINT_NUMBER, HOLDPOINT_FLAG, HOLDPOINT_STRING };

/* A setting of the parameter file. Of nested tables the name is the dotted path. Its texts last as long as the call. */
typedef struct {
    holdpoint_text name;
    uint8_t kind; /* HOLDPOINT_NUMBER, ... */
    union {
        double number;
        bool flag;
        holdpoint_text text;
    };
} holdpoint_parameter;

typedef struct {
    const holdpoint_parameter *all;
    uint32_t count;
} holdpoint_parameters;

/* A sensor that a skill asks for. */
typedef struct {
    holdpoint_text name;
    uint32_t length; /* how many numbers it has */
} holdpoint_sensor;

/* What the code offers and needs. */
typedef struct {
    holdpoint_text task;      /* such as `grasp` */
    holdpoint_text interface; /* as JSON, see `description` in the WIT */
    holdpoint_images images;
    const holdpoint_sensor *sensors; /* those of the cell that it uses; the manifest then declares `named` */
    uint32_t sensor_count;
} holdpoint_description;

/* What a skill defines. A text that is returned is an error; one without bytes is none. */

/* What the code offers and needs; all of it is empty until it is set. */
holdpoint_text skill_describe(holdpoint_parameters parameters, holdpoint_description *description);
/* Begins the one task of this instance. */
holdpoint_text skill_start(uint64_t seed, holdpoint_parameters parameters);
/* One decision: the commands of this tick and of those after it. Returns how many there are, 1 to HOLDPOINT_COMMANDS_MAX. The
 * first is `hold` until it is set. */
uint32_t skill_step(const holdpoint_observation *seen, holdpoint_command *commands);
/* Turns to a hook: the following steps are the hook's. */
void skill_enter(uint8_t hook);

/* Where an object was last seen; 0 if it is not in sight. */
const holdpoint_estimate *holdpoint_named(const holdpoint_observation *seen, holdpoint_text name);
/* What a sensor measured last; 0 if there is nothing. */
const holdpoint_reading *holdpoint_measured(const holdpoint_observation *seen, holdpoint_text name);
/* Reads a number of the parameter file into `value`; false if it has none of that name. */
bool holdpoint_number(holdpoint_parameters parameters, const char *name, double *value);

#endif
