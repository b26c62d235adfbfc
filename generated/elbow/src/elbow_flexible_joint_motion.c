/* elbow: flexible_joint_motion. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_flexible_joint_motion.c"

#include "elbow_lanes.h"
#include "elbow_flexible_joint_motion.c"

#define NAME(suffix) flexible_joint_motion_##suffix
#define PUBLIC(suffix) elbow_flexible_joint_motion_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) INPUT(v_a, ELBOW_NA) INPUT(q_m, ELBOW_NM) INPUT(v_m, ELBOW_NM) OUTPUT(a_a, ELBOW_NA) \
    OUTPUT(j_a, ELBOW_NA)
#define WORK 0
#define SINGLE elbow_flexible_joint_motion(at_q_a, at_v_a, at_q_m, at_v_m, at_a_a, at_j_a)
#define TILE 64
#define RESULTS 4
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_flexible_joint_motion(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], elbow_real a_a[ELBOW_NA],
    elbow_real j_a[ELBOW_NA])
{
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || a_a == NULL || j_a == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return flexible_joint_motion_evaluate_1(q_a, v_a, q_m, v_m, a_a, j_a) == 0 ? ELBOW_OK : flexible_joint_motion_failed(q_a, v_a, q_m, v_m, a_a, j_a, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(flexible_joint_motion_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT q_m, const real *RESTRICT v_m, real *RESTRICT a_a, real *RESTRICT j_a STRIDE(ptrdiff_t n))
{
    const T t4 = IN(q_a, 0);
    const T t9 = IN(q_a, 1);
    const T angle4[ANGLES(2)] = {t4, t9};
    T sine4[ANGLES(2)], cosine4[ANGLES(2)];
    F(sincos)(angle4, sine4, cosine4, 2);
    const T t40 = cosine4[0];
    const T t44 = sine4[0];
    const T t10 = sine4[1];
    const T t20 = cosine4[1];
    const T t56 = 1.15 * t10;
    const T t24 = 190.25 * t10;
    const T t60 = 218.7875 * t20;
    const T t11 = IN(v_a, 0);
    const T t12 = 1.15 * t11;
    const T t15 = IN(v_a, 1);
    const T t16 = t11 + t15;
    const T t21 = t15 * t20;
    const T t26 = t10 * t15;
    const T t31 = 218.7875 * t11;
    const T t76 = 101.7361875 * t10;
    const T t2 = IN(q_m, 0);
    const T t3 = 0.003739316239316239 * t2;
    const T t28 = 190.25 * t20;
    const T t45 = 867.8539125000001 * t10;
    const T t81 = IN(q_m, 1);
    const T t82 = 0.003963011889035667 * t81;
    const T t42 = 867.8539125000001 * t20;
    const T t85 = 867.8539125000001 * t40;
    const T t87 = 867.8539125000001 * t44;
    const T t57 = 0.465 - t56;
    const T t162 = IN(v_m, 1);
    const T t163 = 0.003963011889035667 * t162;
    const T t61 = t20 * t60;
    const T t13 = t10 * t12;
    const T t17 = 0.465 * t16;
    const T t23 = t12 * t21;
    const T t27 = t12 * t26;
    const T t32 = t20 * t31;
    const T t77 = 89.77680625 - t76;
    const T t5 = t3 - t4;
    const T t119 = t15 * t26;
    const T t49 = t45 - 3613.4097102;
    const T t83 = t9 - t82;
    const T t43 = t40 * t42;
    const T t86 = t20 * t85;
    const T t88 = t10 * t87;
    const T t59 = t24 * t57;
    const T t58 = 88.46625 * t57;
    const T t132 = t15 * t21;
    const T t106 = IN(v_m, 0);
    const T t107 = 0.003739316239316239 * t106;
    const T t18 = t13 - t17;
    const T t25 = t23 * t24;
    const T t29 = t27 * t28;
    const T t33 = t26 * t32;
    const T t39 = 88.46625 * t23;
    const T t6 = 7518900.0 * t5;
    const T t91 = t12 * t32;
    const T t50 = t44 * t49;
    const T t84 = 4099900.0 * t83;
    const T t149 = t11 * t44;
    const T t164 = t15 - t163;
    const T t151 = t26 * t85;
    const T t62 = t59 - t61;
    const T t69 = t58 + 203.26239672;
    const T t152 = t11 * t40;
    const T t108 = t11 - t107;
    const T t19 = 190.25 * t18;
    const T t154 = t21 * t87;
    const T t34 = t25 - t33;
    const T t95 = t39 - t88;
    const T t51 = t6 + t43;
    const T t92 = t10 * t91;
    const T t52 = t39 - t50;
    const T t94 = t84 - t86;
    const T t150 = t42 * t149;
    const T t165 = 4099900.0 * t164;
    const T t171 = t21 * t91;
    const T t63 = 1.15 * t62;
    const T t176 = t45 * t152;
    const T t109 = 7518900.0 * t108;
    const T t22 = t19 * t21;
    const T t89 = t12 * t19;
    const T t153 = t49 * t152;
    const T t156 = t151 + t154;
    const T t53 = t51 + t52;
    const T t96 = t92 + t94;
    const T t179 = t150 + t154;
    const T t178 = t151 + t165;
    const T t70 = t63 - t69;
    const T t180 = t171 + t176;
    const T t155 = t109 + t150;
    const T t35 = t22 - t29;
    const T t90 = t20 * t89;
    const T t170 = t26 * t89;
    const T t97 = t95 - t96;
    const T t181 = t178 + t179;
    const T t72 = 1.0 / t70;
    const T t157 = t153 + t155;
    const T t36 = t34 + t35;
    const T t98 = t90 + t97;
    const T t182 = t180 + t181;
    const T t158 = t156 + t157;
    const T t37 = 1.15 * t36;
    const T t183 = t170 + t182;
    const T t54 = t37 - t53;
    const T t78 = t72 * t77;
    const T t73 = t54 * t72;
    const T t100 = t77 * t78;
    const T t93 = t54 * t78;
    const T t101 = 89.77680625 + t100;
    const T t99 = t93 - t98;
    const T t102 = 1.0 / t101;
    const T t103 = t99 * t102;
    OUT(a_a, 1, -t103);
    const T t104 = t78 * t103;
    const T t118 = t20 * t103;
    const T t133 = t10 * t103;
    const T t105 = t73 - t104;
    OUT(a_a, 0, t105);
    const T t120 = t118 + t119;
    const T t134 = t132 - t133;
    const T t110 = 1.15 * t105;
    const T t112 = t103 - t105;
    const T t123 = t12 * t120;
    const T t135 = t12 * t134;
    const T t121 = t19 * t120;
    const T t139 = t32 * t134;
    const T t111 = t10 * t110;
    const T t113 = 0.465 * t112;
    const T t122 = t21 * t110;
    const T t127 = t20 * t110;
    const T t131 = t26 * t110;
    const T t140 = t121 + t139;
    const T t172 = t32 * t110;
    const T t166 = t19 * t110;
    const T t114 = t23 + t111;
    const T t124 = t122 - t123;
    const T t128 = t27 - t127;
    const T t136 = t131 + t135;
    const T t115 = t113 + t114;
    const T t125 = t122 + t124;
    const T t129 = 190.25 * t128;
    const T t137 = t131 + t136;
    const T t116 = 190.25 * t115;
    const T t126 = t24 * t125;
    const T t130 = t26 * t129;
    const T t138 = t28 * t137;
    const T t173 = t12 * t129;
    const T t148 = 88.46625 * t125;
    const T t117 = t21 * t116;
    const T t167 = t12 * t116;
    const T t141 = t126 - t140;
    const T t142 = t130 - t138;
    const T t174 = t172 - t173;
    const T t159 = t148 - t158;
    const T t184 = t148 - t183;
    const T t143 = t117 + t130;
    const T t168 = t166 + t167;
    const T t144 = t117 + t141;
    const T t175 = t10 * t174;
    const T t145 = t142 + t143;
    const T t169 = t20 * t168;
    const T t185 = t175 - t184;
    const T t146 = t144 + t145;
    const T t186 = t169 - t185;
    const T t147 = 1.15 * t146;
    const T t160 = t147 - t159;
    const T t177 = t78 * t160;
    const T t161 = t72 * t160;
    const T t187 = t177 - t186;
    const T t188 = t102 * t187;
    OUT(j_a, 1, -t188);
    const T t189 = t78 * t188;
    const T t190 = t161 - t189;
    OUT(j_a, 0, t190);
    const T z191 = 0.0 * t103 + 0.0 * t105;
    const T z192 = z191 + 0.0 * t188;
    const T z193 = z192 + 0.0 * t190;
    return z193;
}
#endif
