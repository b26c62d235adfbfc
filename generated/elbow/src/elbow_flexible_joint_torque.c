/* elbow: flexible_joint_torque. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_flexible_joint_torque.c"

#include "elbow_lanes.h"
#include "elbow_flexible_joint_torque.c"

#define NAME(suffix) flexible_joint_torque_##suffix
#define PUBLIC(suffix) elbow_flexible_joint_torque_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(a_a, ELBOW_NA) INPUT(j_a, ELBOW_NA) INPUT(s_a, ELBOW_NA) \
    INPUT(q_m, ELBOW_NM) INPUT(v_m, ELBOW_NM) OUTPUT(tau_m, ELBOW_NM)
#define WORK 0
#define SINGLE elbow_flexible_joint_torque(at_q_a, at_v_a, at_a_a, at_j_a, at_s_a, at_q_m, at_v_m, at_tau_m)
#define TILE 64
#define RESULTS 2
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_flexible_joint_torque(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], const elbow_real j_a[ELBOW_NA], const elbow_real s_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], elbow_real tau_m[ELBOW_NM])
{
    if (q_a == NULL || v_a == NULL || a_a == NULL || j_a == NULL || s_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return flexible_joint_torque_evaluate_1(q_a, v_a, a_a, j_a, s_a, q_m, v_m, tau_m) == 0 ? ELBOW_OK : flexible_joint_torque_failed(q_a, v_a, a_a, j_a, s_a, q_m, v_m, tau_m, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(flexible_joint_torque_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT a_a, const real *RESTRICT j_a, const real *RESTRICT s_a, const real *RESTRICT q_m, const real *RESTRICT v_m, real *RESTRICT tau_m STRIDE(ptrdiff_t n))
{
    const T t10 = IN(q_a, 1);
    const T t132 = IN(q_a, 0);
    const T angle10[ANGLES(2)] = {t10, t132};
    T sine10[ANGLES(2)], cosine10[ANGLES(2)];
    F(sincos)(angle10, sine10, cosine10, 2);
    const T t11 = cosine10[0];
    const T t15 = sine10[0];
    const T t133 = cosine10[1];
    const T t136 = sine10[1];
    const T t14 = IN(v_a, 1);
    const T t16 = t14 * t15;
    const T t20 = t11 * t14;
    const T t3 = IN(s_a, 0);
    const T t4 = IN(s_a, 1);
    const T t5 = t3 + t4;
    const T t1 = IN(a_a, 0);
    const T t9 = 1.15 * t1;
    const T t12 = IN(a_a, 1);
    const T t13 = t11 * t12;
    const T t21 = IN(j_a, 0);
    const T t22 = 1.15 * t21;
    const T t27 = IN(j_a, 1);
    const T t28 = t11 * t27;
    const T t31 = t12 * t15;
    const T t38 = 1.15 * t3;
    const T t53 = t1 + t12;
    const T t62 = t21 + t27;
    const T t85 = t15 * t27;
    const T t25 = IN(v_a, 0);
    const T t26 = 1.15 * t25;
    const T t72 = t14 + t25;
    const T t112 = 218.7875 * t25;
    const T t134 = t25 * t133;
    const T t17 = t14 * t16;
    const T t29 = t12 * t16;
    const T t30 = t14 * t20;
    const T t83 = t12 * t20;
    const T t41 = 0.465 * t5;
    const T t52 = t9 * t15;
    const T t59 = t9 * t20;
    const T t61 = t15 * t22;
    const T t39 = t15 * t38;
    const T t54 = 0.465 * t53;
    const T t63 = 0.465 * t62;
    const T t97 = t11 * t22;
    const T t98 = t9 * t16;
    const T t23 = t20 * t22;
    const T t51 = t20 * t26;
    const T t71 = t15 * t26;
    const T t18 = t13 - t17;
    const T t34 = t28 - t29;
    const T t32 = t30 + t31;
    const T t86 = t83 + t85;
    const T t73 = 0.465 * t72;
    const T t79 = t11 * t38;
    const T t65 = t59 + t59;
    const T t80 = t16 * t22;
    const T t42 = t39 - t41;
    const T t55 = t52 - t54;
    const T t64 = t61 - t63;
    const T t105 = t9 * t11;
    const T t100 = t97 - t98;
    const T t106 = t16 * t26;
    const T t141 = t25 * t136;
    const T t113 = t11 * t112;
    const T t84 = t14 * t18;
    const T t35 = t29 - t34;
    const T t33 = t14 * t32;
    const T t87 = t83 + t86;
    const T t19 = t9 * t18;
    const T t60 = t18 * t26;
    const T t74 = t71 - t73;
    const T t81 = t9 * t32;
    const T t43 = t23 + t42;
    const T t56 = t51 + t55;
    const T t66 = t64 + t65;
    const T t90 = t79 - t80;
    const T t99 = t26 * t32;
    const T t101 = t98 - t100;
    const T t107 = t105 - t106;
    const T t128 = 44.335 * t3;
    const T t135 = t25 * t134;
    const T t137 = t1 * t136;
    const T t36 = t33 + t35;
    const T t88 = t84 + t87;
    const T t24 = t19 + t23;
    const T t153 = t1 * t133;
    const T t75 = 190.25 * t74;
    const T t82 = t80 + t81;
    const T t44 = t19 + t43;
    const T t57 = 190.25 * t56;
    const T t67 = t60 + t66;
    const T t91 = t81 - t90;
    const T t154 = t25 * t141;
    const T t102 = t99 + t101;
    const T t108 = 190.25 * t107;
    const T t208 = 867.8539125000001 * t16;
    const T t210 = 867.8539125000001 * t20;
    const T t130 = 65.95239672 * t3;
    const T t37 = t26 * t36;
    const T t89 = t26 * t88;
    const T t45 = t24 + t24;
    const T t114 = t88 * t113;
    const T t76 = t36 * t75;
    const T t92 = t82 + t82;
    const T t138 = t135 + t137;
    const T t58 = t18 * t57;
    const T t68 = 190.25 * t67;
    const T t139 = 867.8539125000001 * t11;
    const T t142 = 867.8539125000001 * t141;
    const T t103 = 190.25 * t102;
    const T t109 = t32 * t108;
    const T t144 = 867.8539125000001 * t133;
    const T t148 = 867.8539125000001 * t15;
    const T t155 = t153 - t154;
    const T t46 = t37 - t44;
    const T t93 = t89 + t91;
    const T t157 = 867.8539125000001 * t136;
    const T t159 = t128 + t128;
    const T t183 = t9 * t57;
    const T t184 = t22 * t75;
    const T t199 = t26 * t113;
    const T t209 = t141 * t208;
    const T t211 = t134 * t210;
    const T t69 = t20 * t68;
    const T t77 = 190.25 * t15;
    const T t95 = 190.25 * t11;
    const T t104 = t16 * t103;
    const T t115 = t58 - t109;
    const T t116 = t76 + t114;
    const T t140 = t138 * t139;
    const T t47 = t45 - t46;
    const T t94 = t92 + t93;
    const T t143 = t16 * t142;
    const T t145 = t32 * t144;
    const T t146 = 867.8539125000001 * t134;
    const T t152 = t148 - 3613.4097102;
    const T t158 = t18 * t157;
    const T t160 = t130 + t159;
    const T t186 = t183 + t184;
    const T t190 = t9 * t75;
    const T t191 = t26 * t57;
    const T t194 = t75 * t99;
    const T t195 = t9 * t113;
    const T t196 = t26 * t108;
    const T t200 = t18 * t199;
    const T t201 = t9 * t108;
    const T t202 = t22 * t113;
    const T t212 = t148 * t155;
    const T t213 = t209 + t209;
    const T t214 = t211 + t211;
    const T t70 = t58 + t69;
    const T t78 = t47 * t77;
    const T t96 = t94 * t95;
    const T t110 = t104 - t109;
    const T t117 = t69 + t115;
    const T t118 = t104 - t116;
    const T t147 = t20 * t146;
    const T t156 = t152 * t155;
    const T t161 = t143 - t160;
    const T t185 = t26 * t68;
    const T t187 = t183 + t186;
    const T t192 = t190 + t191;
    const T t197 = t195 + t196;
    const T t204 = t201 + t202;
    const T t215 = t145 + t200;
    const T t216 = t140 + t158;
    const T t217 = t212 - t213;
    const T t218 = t194 + t214;
    const T t119 = t70 + t70;
    const T t120 = t110 + t110;
    const T t122 = t78 - t96;
    const T t121 = t117 + t118;
    const T t162 = t143 - t147;
    const T t163 = t140 + t147;
    const T t164 = t145 + t156;
    const T t165 = t158 - t161;
    const T t188 = t185 + t187;
    const T t193 = t16 * t192;
    const T t198 = t20 * t197;
    const T t203 = t26 * t103;
    const T t205 = t201 + t204;
    const T t219 = t215 + t216;
    const T t6 = 48.64 * t5;
    const T t220 = t217 + t218;
    const T t48 = 88.46625 * t47;
    const T t123 = t119 + t120;
    const T t177 = IN(q_m, 0);
    const T t178 = 0.003739316239316239 * t177;
    const T t124 = t121 + t122;
    const T t235 = IN(q_m, 1);
    const T t236 = 0.003963011889035667 * t235;
    const T t166 = t162 - t163;
    const T t167 = t164 + t165;
    const T t189 = t11 * t188;
    const T t222 = t193 + t198;
    const T t206 = t203 - t205;
    const T t221 = t193 + t219;
    const T t223 = t198 + t220;
    const T t49 = t6 - t48;
    const T t179 = t132 - t178;
    const T t125 = t123 + t124;
    const T t237 = t10 - t236;
    const T t168 = t166 - t167;
    const T t207 = t15 * t206;
    const T t224 = t221 + t222;
    const T t225 = t189 - t223;
    const T t180 = 28115.54487179487 * t179;
    const T t126 = 1.15 * t125;
    const T t238 = 16247.952443857332 * t237;
    const T t169 = t49 - t168;
    const T t226 = t207 - t224;
    const T t227 = t49 - t225;
    const T t170 = t126 + t169;
    const T t228 = t226 - t227;
    const T t172 = 1.3299817792496243e-07 * t170;
    const T t230 = 2.4390838800946363e-07 * t228;
    const T t173 = t1 + t172;
    const T t231 = t12 - t230;
    const T t174 = 3.155657142857143 * t173;
    const T t232 = 2.9775333333333336 * t231;
    const T t181 = t174 - t180;
    OUT(tau_m, 0, t181);
    const T t239 = t232 - t238;
    OUT(tau_m, 1, t239);
    const T z242 = 0.0 * IN(v_m, 0) + 0.0 * IN(v_m, 1);
    const T z243 = z242 + 0.0 * t239;
    const T z244 = z243 + 0.0 * t181;
    return z244;
}
#endif
