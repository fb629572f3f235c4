/* What a Cortex-M4 begins with: the vectors, and the unit for numbers in single precision. */
extern unsigned int stack_top;
void _start(void);

static void reset(void)
{
    *(volatile unsigned int *)0xE000ED88u |= 0xFu << 20;
    _start();
}

static void stop(void)
{
    for (;;) {
    }
}

/* Where the stack begins, what is called first, and what faults lead to. */
__attribute__((section(".vectors"), used)) static const struct {
    unsigned int *stack;
    void (*handlers[15])(void);
} vectors = {
    &stack_top,
    {reset, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop},
};
