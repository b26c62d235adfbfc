/* elbow: flexible_joint_torque. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, then lanes of numbers */
#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_flexible_joint_torque.c"

#include "elbow_lanes.h"
#include "elbow_flexible_joint_torque.c"

#define NAME(suffix) flexible_joint_torque_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT, LAST) \
    INPUT(q_a, 2) INPUT(v_a, 2) INPUT(a_a, 2) INPUT(j_a, 2) INPUT(s_a, 2) INPUT(q_m, 2) INPUT(v_m, 2) LAST(tau_m, 2)
#define WORK 0
#define SINGLE elbow_flexible_joint_torque
#define TILE 64
#define RESULTS 2
#include "elbow_function.h"
#include "elbow_undefine.h"
#else /* the mathematics */
static T F(flexible_joint_torque_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT a_a, const real *RESTRICT j_a, const real *RESTRICT s_a, const real *RESTRICT q_m, const real *RESTRICT v_m, real *RESTRICT tau_m STRIDE(ptrdiff_t n))
{
    T t10 = IN(q_a, 1);
    T t132 = IN(q_a, 0);
    SINES_COSINES(10, 2, t10, t132)
    T t11 = cosine10[0];
    T t15 = sine10[0];
    T t133 = cosine10[1];
    T t136 = sine10[1];
    T t14 = IN(v_a, 1);
    T t16 = t14 * t15;
    T t20 = t11 * t14;
    T t3 = IN(s_a, 0);
    T t4 = IN(s_a, 1);
    T t5 = t3 + t4;
    T t1 = IN(a_a, 0);
    T t9 = 1.15 * t1;
    T t12 = IN(a_a, 1);
    T t13 = t11 * t12;
    T t21 = IN(j_a, 0);
    T t22 = 1.15 * t21;
    T t27 = IN(j_a, 1);
    T t28 = t11 * t27;
    T t31 = t12 * t15;
    T t38 = 1.15 * t3;
    T t53 = t1 + t12;
    T t62 = t21 + t27;
    T t85 = t15 * t27;
    T t25 = IN(v_a, 0);
    T t26 = 1.15 * t25;
    T t72 = t14 + t25;
    T t112 = 218.7875 * t25;
    T t134 = t25 * t133;
    T t17 = t14 * t16;
    T t29 = t12 * t16;
    T t30 = t14 * t20;
    T t83 = t12 * t20;
    T t41 = 0.465 * t5;
    T t52 = t9 * t15;
    T t59 = t9 * t20;
    T t61 = t15 * t22;
    T t39 = t15 * t38;
    T t54 = 0.465 * t53;
    T t63 = 0.465 * t62;
    T t97 = t11 * t22;
    T t98 = t9 * t16;
    T t23 = t20 * t22;
    T t51 = t20 * t26;
    T t71 = t15 * t26;
    T t18 = t13 - t17;
    T t34 = t28 - t29;
    T t32 = t30 + t31;
    T t86 = t83 + t85;
    T t73 = 0.465 * t72;
    T t79 = t11 * t38;
    T t65 = t59 + t59;
    T t80 = t16 * t22;
    T t42 = t39 - t41;
    T t55 = t52 - t54;
    T t64 = t61 - t63;
    T t105 = t9 * t11;
    T t100 = t97 - t98;
    T t106 = t16 * t26;
    T t141 = t25 * t136;
    T t113 = t11 * t112;
    T t84 = t14 * t18;
    T t35 = t29 - t34;
    T t33 = t14 * t32;
    T t87 = t83 + t86;
    T t19 = t9 * t18;
    T t60 = t18 * t26;
    T t74 = t71 - t73;
    T t81 = t9 * t32;
    T t43 = t23 + t42;
    T t56 = t51 + t55;
    T t66 = t64 + t65;
    T t90 = t79 - t80;
    T t99 = t26 * t32;
    T t101 = t98 - t100;
    T t107 = t105 - t106;
    T t128 = 44.335 * t3;
    T t135 = t25 * t134;
    T t137 = t1 * t136;
    T t36 = t33 + t35;
    T t88 = t84 + t87;
    T t24 = t19 + t23;
    T t153 = t1 * t133;
    T t75 = 190.25 * t74;
    T t82 = t80 + t81;
    T t44 = t19 + t43;
    T t57 = 190.25 * t56;
    T t67 = t60 + t66;
    T t91 = t81 - t90;
    T t154 = t25 * t141;
    T t102 = t99 + t101;
    T t108 = 190.25 * t107;
    T t208 = 867.8539125000001 * t16;
    T t210 = 867.8539125000001 * t20;
    T t130 = 65.95239672 * t3;
    T t37 = t26 * t36;
    T t89 = t26 * t88;
    T t45 = t24 + t24;
    T t114 = t88 * t113;
    T t76 = t36 * t75;
    T t92 = t82 + t82;
    T t138 = t135 + t137;
    T t58 = t18 * t57;
    T t68 = 190.25 * t67;
    T t139 = 867.8539125000001 * t11;
    T t142 = 867.8539125000001 * t141;
    T t103 = 190.25 * t102;
    T t109 = t32 * t108;
    T t144 = 867.8539125000001 * t133;
    T t148 = 867.8539125000001 * t15;
    T t155 = t153 - t154;
    T t46 = t37 - t44;
    T t93 = t89 + t91;
    T t157 = 867.8539125000001 * t136;
    T t159 = t128 + t128;
    T t183 = t9 * t57;
    T t184 = t22 * t75;
    T t199 = t26 * t113;
    T t209 = t141 * t208;
    T t211 = t134 * t210;
    T t69 = t20 * t68;
    T t77 = 190.25 * t15;
    T t95 = 190.25 * t11;
    T t104 = t16 * t103;
    T t115 = t58 - t109;
    T t116 = t76 + t114;
    T t140 = t138 * t139;
    T t47 = t45 - t46;
    T t94 = t92 + t93;
    T t143 = t16 * t142;
    T t145 = t32 * t144;
    T t146 = 867.8539125000001 * t134;
    T t152 = t148 - 3613.4097102;
    T t158 = t18 * t157;
    T t160 = t130 + t159;
    T t186 = t183 + t184;
    T t190 = t9 * t75;
    T t191 = t26 * t57;
    T t194 = t75 * t99;
    T t195 = t9 * t113;
    T t196 = t26 * t108;
    T t200 = t18 * t199;
    T t201 = t9 * t108;
    T t202 = t22 * t113;
    T t212 = t148 * t155;
    T t213 = t209 + t209;
    T t214 = t211 + t211;
    T t70 = t58 + t69;
    T t78 = t47 * t77;
    T t96 = t94 * t95;
    T t110 = t104 - t109;
    T t117 = t69 + t115;
    T t118 = t104 - t116;
    T t147 = t20 * t146;
    T t156 = t152 * t155;
    T t161 = t143 - t160;
    T t185 = t26 * t68;
    T t187 = t183 + t186;
    T t192 = t190 + t191;
    T t197 = t195 + t196;
    T t204 = t201 + t202;
    T t215 = t145 + t200;
    T t216 = t140 + t158;
    T t217 = t212 - t213;
    T t218 = t194 + t214;
    T t119 = t70 + t70;
    T t120 = t110 + t110;
    T t122 = t78 - t96;
    T t121 = t117 + t118;
    T t162 = t143 - t147;
    T t163 = t140 + t147;
    T t164 = t145 + t156;
    T t165 = t158 - t161;
    T t188 = t185 + t187;
    T t193 = t16 * t192;
    T t198 = t20 * t197;
    T t203 = t26 * t103;
    T t205 = t201 + t204;
    T t219 = t215 + t216;
    T t6 = 48.64 * t5;
    T t220 = t217 + t218;
    T t48 = 88.46625 * t47;
    T t123 = t119 + t120;
    T t177 = IN(q_m, 0);
    T t178 = 0.003739316239316239 * t177;
    T t124 = t121 + t122;
    T t235 = IN(q_m, 1);
    T t236 = 0.003963011889035667 * t235;
    T t166 = t162 - t163;
    T t167 = t164 + t165;
    T t189 = t11 * t188;
    T t222 = t193 + t198;
    T t206 = t203 - t205;
    T t221 = t193 + t219;
    T t223 = t198 + t220;
    T t49 = t6 - t48;
    T t179 = t132 - t178;
    T t125 = t123 + t124;
    T t237 = t10 - t236;
    T t168 = t166 - t167;
    T t207 = t15 * t206;
    T t224 = t221 + t222;
    T t225 = t189 - t223;
    T t180 = 28115.54487179487 * t179;
    T t126 = 1.15 * t125;
    T t238 = 16247.952443857332 * t237;
    T t169 = t49 - t168;
    T t226 = t207 - t224;
    T t227 = t49 - t225;
    T t170 = t126 + t169;
    T t228 = t226 - t227;
    T t172 = 1.3299817792496243e-07 * t170;
    T t230 = 2.4390838800946363e-07 * t228;
    T t173 = t1 + t172;
    T t231 = t12 - t230;
    T t174 = 3.155657142857143 * t173;
    T t232 = 2.9775333333333336 * t231;
    T t181 = t174 - t180;
    OUT(tau_m, 0, t181);
    T t239 = t232 - t238;
    OUT(tau_m, 1, t239);
    return 0.0 * IN(v_m, 0) + 0.0 * IN(v_m, 1) + 0.0 * t239 + 0.0 * t181;
}
#endif
