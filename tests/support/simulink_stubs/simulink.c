/* What a MEX file of an S-function ends with. */
static void stub_use(SimStruct *S)
{
    mdlInitializeSizes(S);
    mdlInitializeSampleTimes(S);
}
