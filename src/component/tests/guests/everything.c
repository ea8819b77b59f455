/* A skill built with an ordinary C library for WASI: it allocates, prints, draws numbers, reads clocks and sleeps. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define EXPORT(name) __attribute__((export_name("holdpoint:skill/skill@1.0.0#" name)))

static const char *interface_text =
    "{\"controller\":\"everything\",\"semantics_version\":\"1.0.0\",\"entry_points\":[],\"inputs\":{},\"outputs\":{},"
    "\"parameters\":{},\"hooks\":[],\"failure_signals\":[],\"needs\":[]}";

typedef struct { uint32_t name, name_length; uint32_t kind, pad; union { double number; uint8_t flag; struct { uint32_t text, length; }; }; } parameter;
typedef struct { uint32_t failed; uint32_t task; const char *text; uint32_t length; } described;
typedef struct { uint32_t failed; const char *text; uint32_t length; } started;
typedef struct { uint64_t kind; double numbers[10]; } command;
typedef struct { uint64_t tick; uint64_t q_count; double q[8]; } observation;

__attribute__((export_name("cabi_realloc"))) void *cabi_realloc(void *old, size_t bytes, size_t align, size_t wanted) {
    (void)bytes, (void)align;
    return realloc(old, wanted);
}

EXPORT("describe") described *describe(parameter *parameters, size_t count) {
    static described answer;
    free(parameters);
    printf("described with %zu parameters\n", count);
    answer.text = interface_text;
    answer.length = strlen(interface_text);
    return &answer;
}

static double speed;

EXPORT("start") started *start(uint64_t seed, parameter *parameters, size_t count) {
    static started answer;
    unsigned char drawn[8];
    if (count > 0 && parameters[0].kind == 0) speed = parameters[0].number;
    getentropy(drawn, sizeof drawn);
    uint64_t number = 0;
    memcpy(&number, drawn, sizeof drawn);
    srand((unsigned)number);
    printf("started with seed %llu, speed %.3f, drew %016llx\n", (unsigned long long)seed, speed, (unsigned long long)number);
    if (getenv("HOME") || fopen("/etc/passwd", "r")) abort();
    if (fgetc(stdin) != EOF) abort();
    return &answer;
}

/* Joints: a number drawn, the two clocks, and how long a sleep took. */
EXPORT("tick") command *tick(observation *seen) {
    static command answer;
    struct timespec before, after, wall, asked = {1, 0};
    clock_gettime(CLOCK_MONOTONIC, &before);
    nanosleep(&asked, NULL);
    clock_gettime(CLOCK_MONOTONIC, &after);
    clock_gettime(CLOCK_REALTIME, &wall);
    double *scratch = malloc(100 * sizeof *scratch);
    for (int i = 0; i < 100; i++) scratch[i] = seen->q[i % 7] + i;
    answer.kind = 2;
    *(uint8_t *)&answer.numbers[0] = 5;
    answer.numbers[1] = rand() / (RAND_MAX + 1.0);
    answer.numbers[2] = before.tv_sec + 1e-9 * before.tv_nsec;
    answer.numbers[3] = (after.tv_sec - before.tv_sec) + 1e-9 * (after.tv_nsec - before.tv_nsec);
    answer.numbers[4] = wall.tv_sec;
    answer.numbers[5] = scratch[99];
    answer.numbers[9] = speed;
    free(scratch);
    free(seen);
    return &answer;
}

EXPORT("enter") void enter(uint32_t hook) {
    fprintf(stderr, "entered %u\n", hook);
    if (hook == 1) exit(3);
}
