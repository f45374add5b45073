/* Sizes and names of this model for the interface; written by casadi_skin. */
#ifndef CONFIG_H
#define CONFIG_H

#define INSTANTIATION_TOKEN "@token"
#define DEFAULT_TOLERANCE @tolerance

/* Numbers of states, parameters with the inputs, which are the last, inputs, and outputs that are no states;
   sizes of the work arrays. */
enum { NX = @states, NP = @parameters, NI = @inputs, NY = @outputs };
enum { SZ_ARG = @sz_arg, SZ_RES = @sz_res, SZ_IW = @sz_iw, SZ_W = @sz_w };

typedef long long int casadi_int;
@prototypes
#define MODEL_DERIVATIVES @equations_derivatives
#define MODEL_OUTPUTS @equations_outputs
#define MODEL_FORWARD @equations_forward
#define MODEL_ADJOINT @equations_adjoint

@arrays

#endif
