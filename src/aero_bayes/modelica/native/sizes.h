/* Sizes of the model, and the value references that its groups of variables begin at. */
#ifndef AERO_BAYES_SIZES_H
#define AERO_BAYES_SIZES_H
#include "model.h"

#define INFO model_info
#define MODEL_SIZE (sizeof(Model) + sizeof(double) * INFO.size)
#define NX INFO.nx
#define NXX (INFO.nx + 1)
#define AT_DX (unsigned)INFO.nx
#define AT_U (2 * AT_DX)
#define AT_P (AT_U + INFO.nu)
#define AT_Q (AT_P + INFO.np)
#define AT_Y (AT_Q + INFO.nq)
#define NREAL (AT_Y + INFO.ny)
#define NROW (INFO.nx + INFO.ny + INFO.nq)

static inline double *group(Model *m, enum Group g) { return m->data + INFO.at[g]; }

#endif
