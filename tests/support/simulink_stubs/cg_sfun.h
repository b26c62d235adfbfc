/* What a program that includes an S-function needs of it. */
static void stub_use(SimStruct *S)
{
    mdlInitializeSizes(S);
    mdlInitializeSampleTimes(S);
}
