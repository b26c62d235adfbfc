/*
 * An emulated Cortex-M7 (the board mps2-an500): switch the floating-point unit on, then newlib's
 * own start.
 */
extern void _start(void);
void reset(void);
void reset(void)
{
    *(volatile unsigned *)0xE000ED88u |= 0xFu << 20;
    __asm volatile("dsb\n isb");
    _start();
}
extern char __stack[];
__attribute__((section(".vectors"), used))
const void *const vectors[2] = {__stack, (const void *)reset};
