/* Registers of the STM32H743 that the board uses (reference manual RM0433), and its pins on a NUCLEO-H743ZI2. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define BIT(number) (1u << (number))

/* Reset and clocks */
#define RCC_CR REGISTER(0x58024400u)
#define RCC_D2CCIP1R REGISTER(0x58024450u)
#define RCC_D2CCIP2R REGISTER(0x58024454u)
#define RCC_CSR REGISTER(0x58024474u)
#define RCC_AHB2ENR REGISTER(0x580244DCu)
#define RCC_AHB4ENR REGISTER(0x580244E0u)
#define RCC_APB1LENR REGISTER(0x580244E8u)
#define RCC_APB2ENR REGISTER(0x580244F0u)
#define RCC_APB4ENR REGISTER(0x580244F4u)
#define CLOCK_HZ 64000000u /* the internal oscillator, as after a reset */
#define SLOW_HZ 32000u     /* the other internal oscillator */

/* Pins: port A is 0 */
#define GPIO(port, offset) REGISTER(0x58020000u + 0x400u * (port) + (offset))
#define GPIO_MODE(port) GPIO(port, 0x00u)
#define GPIO_SPEED(port) GPIO(port, 0x08u)
#define GPIO_PULL(port) GPIO(port, 0x0Cu)
#define GPIO_INPUT(port) GPIO(port, 0x10u)
#define GPIO_SET_CLEAR(port) GPIO(port, 0x18u)
#define GPIO_FUNCTION(port, pin) GPIO(port, 0x20u + 4u * ((pin) / 8u))
enum port { PORT_A, PORT_B, PORT_C, PORT_D, PORT_E };

/* Line: USART 3 on PD8 and PD9, the virtual port of the on-board programmer */
#define USART_CR1 REGISTER(0x40004800u)
#define USART_BRR REGISTER(0x4000480Cu)
#define USART_ISR REGISTER(0x4000481Cu)
#define USART_ICR REGISTER(0x40004820u)
#define USART_RDR REGISTER(0x40004824u)
#define USART_TDR REGISTER(0x40004828u)
#define USART_RECEIVED BIT(5)
#define USART_ROOM BIT(7)
#define USART_INTERRUPT 39u

/* Converters: SPI 1 on PA5 (clock), PA6 (from the converter), PA7 (to the converter) */
#define SPI_CR1 REGISTER(0x40013000u)
#define SPI_CR2 REGISTER(0x40013004u)
#define SPI_CFG1 REGISTER(0x40013008u)
#define SPI_CFG2 REGISTER(0x4001300Cu)
#define SPI_SR REGISTER(0x40013014u)
#define SPI_IFCR REGISTER(0x40013018u)
#define SPI_TXDR REGISTER(0x40013020u)
#define SPI_RXDR REGISTER(0x40013030u)
#define SPI_ARRIVED BIT(0)
#define SPI_ROOM BIT(1)
#define SPI_ENDED BIT(3)

/* Sample clock: timer 3, channel 1 on PC6 starts the conversion; its end on PC7 is the sample interrupt */
#define TIMER_CR1 REGISTER(0x40000400u)
#define TIMER_EGR REGISTER(0x40000414u)
#define TIMER_CCMR1 REGISTER(0x40000418u)
#define TIMER_CCER REGISTER(0x40000420u)
#define TIMER_ARR REGISTER(0x4000042Cu)
#define TIMER_CCR1 REGISTER(0x40000434u)
#define SYSCFG_EXTICR2 REGISTER(0x5800040Cu)
#define EXTI_FTSR1 REGISTER(0x58000004u)
#define EXTI_IMR1 REGISTER(0x58000080u)
#define EXTI_PR1 REGISTER(0x58000088u)
#define SAMPLE_INTERRUPT 23u

/* Clock of the firmware's watchdog: low-power timer 1 on the slow oscillator */
#define SLOW_CFGR REGISTER(0x4000240Cu)
#define SLOW_CR REGISTER(0x40002410u)
#define SLOW_ARR REGISTER(0x40002418u)
#define SLOW_CNT REGISTER(0x4000241Cu)
#define SLOW_ISR REGISTER(0x40002400u)

/* Hardware watchdog, on the slow oscillator as well; noise source */
#define WATCHDOG_KR REGISTER(0x58004800u)
#define WATCHDOG_PR REGISTER(0x58004804u)
#define WATCHDOG_RLR REGISTER(0x58004808u)
#define WATCHDOG_SR REGISTER(0x5800480Cu)
#define RNG_CR REGISTER(0x48021800u)
#define RNG_SR REGISTER(0x48021804u)
#define RNG_DR REGISTER(0x48021808u)

/* Processor */
#define INTERRUPT_ENABLE(number) REGISTER(0xE000E100u + 4u * ((number) / 32u))
#define INTERRUPT_PRIORITY(number) (*(volatile uint8_t *)(0xE000E400u + (number)))

/* Pins of port E */
#define PIN_BUTTON 2u    /* in, pull-up: open is pressed */
#define PIN_AMPLIFIER 3u /* out, pull-down on the board of the amplifier: high is enabled */
#define PIN_DAC 4u       /* out: low selects the digital-to-analogue converter */
#define PIN_ADC 5u       /* out: low selects the analogue-to-digital converter */
#define PIN_ADC_RESET 6u /* out: a pulse resets it */
#define PIN_SUPPLY 7u    /* in, pull-down: high while the amplifier's supply is above 40 % */

#endif
