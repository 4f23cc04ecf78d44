/* Start of a Cortex-M. */
#ifndef START_H
#define START_H

typedef void (*vector)(void);

int main(void);
void reset(void);
void halt(void);

#endif
