#include "answers.h"

void answers_clear(struct answers *answers)
{
    answers->count = 0;
    answers->oldest = 0;
}

const struct answer *answers_find(const struct answers *answers, uint8_t type, uint16_t sequence)
{
    for (size_t k = 0; k < answers->count; k++) {
        const struct answer *answer = &answers->kept[k];
        if (answer->type == type && answer->sequence == sequence) {
            return answer;
        }
    }
    return NULL;
}

void answers_keep(struct answers *answers, const struct answer *answer)
{
    if (answers->count < ANSWERS) {
        answers->kept[answers->count] = *answer;
        answers->count++;
    } else {
        answers->kept[answers->oldest] = *answer;
        answers->oldest = (answers->oldest + 1u) % ANSWERS;
    }
}
