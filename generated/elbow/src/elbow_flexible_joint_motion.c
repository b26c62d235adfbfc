/* elbow: flexible_joint_motion. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, then lanes of numbers */
#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_flexible_joint_motion.c"

#include "elbow_lanes.h"
#include "elbow_flexible_joint_motion.c"

#define NAME(suffix) flexible_joint_motion_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT, LAST) \
    INPUT(q_a, 2) INPUT(v_a, 2) INPUT(q_m, 2) INPUT(v_m, 2) OUTPUT(a_a, 2) LAST(j_a, 2)
#define WORK 0
#define SINGLE elbow_flexible_joint_motion
#define TILE 64
#define RESULTS 4
#include "elbow_function.h"
#include "elbow_undefine.h"
#else /* the mathematics */
static T F(flexible_joint_motion_evaluate)(const real *RESTRICT q_a, const real *RESTRICT v_a, const real *RESTRICT q_m, const real *RESTRICT v_m, real *RESTRICT a_a, real *RESTRICT j_a STRIDE(ptrdiff_t n))
{
    T t4 = IN(q_a, 0);
    T t9 = IN(q_a, 1);
    SINES_COSINES(4, 2, t4, t9)
    T t40 = cosine4[0];
    T t44 = sine4[0];
    T t10 = sine4[1];
    T t20 = cosine4[1];
    T t56 = 1.15 * t10;
    T t24 = 190.25 * t10;
    T t60 = 218.7875 * t20;
    T t11 = IN(v_a, 0);
    T t12 = 1.15 * t11;
    T t15 = IN(v_a, 1);
    T t16 = t11 + t15;
    T t21 = t15 * t20;
    T t26 = t10 * t15;
    T t31 = 218.7875 * t11;
    T t76 = 101.7361875 * t10;
    T t2 = IN(q_m, 0);
    T t3 = 0.003739316239316239 * t2;
    T t28 = 190.25 * t20;
    T t45 = 867.8539125000001 * t10;
    T t81 = IN(q_m, 1);
    T t82 = 0.003963011889035667 * t81;
    T t42 = 867.8539125000001 * t20;
    T t85 = 867.8539125000001 * t40;
    T t87 = 867.8539125000001 * t44;
    T t57 = 0.465 - t56;
    T t162 = IN(v_m, 1);
    T t163 = 0.003963011889035667 * t162;
    T t61 = t20 * t60;
    T t13 = t10 * t12;
    T t17 = 0.465 * t16;
    T t23 = t12 * t21;
    T t27 = t12 * t26;
    T t32 = t20 * t31;
    T t77 = 89.77680625 - t76;
    T t5 = t3 - t4;
    T t119 = t15 * t26;
    T t49 = t45 - 3613.4097102;
    T t83 = t9 - t82;
    T t43 = t40 * t42;
    T t86 = t20 * t85;
    T t88 = t10 * t87;
    T t59 = t24 * t57;
    T t58 = 88.46625 * t57;
    T t132 = t15 * t21;
    T t106 = IN(v_m, 0);
    T t107 = 0.003739316239316239 * t106;
    T t18 = t13 - t17;
    T t25 = t23 * t24;
    T t29 = t27 * t28;
    T t33 = t26 * t32;
    T t39 = 88.46625 * t23;
    T t6 = 7518900.0 * t5;
    T t91 = t12 * t32;
    T t50 = t44 * t49;
    T t84 = 4099900.0 * t83;
    T t149 = t11 * t44;
    T t164 = t15 - t163;
    T t151 = t26 * t85;
    T t62 = t59 - t61;
    T t69 = t58 + 203.26239672;
    T t152 = t11 * t40;
    T t108 = t11 - t107;
    T t19 = 190.25 * t18;
    T t154 = t21 * t87;
    T t34 = t25 - t33;
    T t95 = t39 - t88;
    T t51 = t6 + t43;
    T t92 = t10 * t91;
    T t52 = t39 - t50;
    T t94 = t84 - t86;
    T t150 = t42 * t149;
    T t165 = 4099900.0 * t164;
    T t171 = t21 * t91;
    T t63 = 1.15 * t62;
    T t176 = t45 * t152;
    T t109 = 7518900.0 * t108;
    T t22 = t19 * t21;
    T t89 = t12 * t19;
    T t153 = t49 * t152;
    T t156 = t151 + t154;
    T t53 = t51 + t52;
    T t96 = t92 + t94;
    T t179 = t150 + t154;
    T t178 = t151 + t165;
    T t70 = t63 - t69;
    T t180 = t171 + t176;
    T t155 = t109 + t150;
    T t35 = t22 - t29;
    T t90 = t20 * t89;
    T t170 = t26 * t89;
    T t97 = t95 - t96;
    T t181 = t178 + t179;
    T t72 = 1.0 / t70;
    T t157 = t153 + t155;
    T t36 = t34 + t35;
    T t98 = t90 + t97;
    T t182 = t180 + t181;
    T t158 = t156 + t157;
    T t37 = 1.15 * t36;
    T t183 = t170 + t182;
    T t54 = t37 - t53;
    T t78 = t72 * t77;
    T t73 = t54 * t72;
    T t100 = t77 * t78;
    T t93 = t54 * t78;
    T t101 = 89.77680625 + t100;
    T t99 = t93 - t98;
    T t102 = 1.0 / t101;
    T t103 = t99 * t102;
    OUT(a_a, 1, -t103);
    T t104 = t78 * t103;
    T t118 = t20 * t103;
    T t133 = t10 * t103;
    T t105 = t73 - t104;
    OUT(a_a, 0, t105);
    T t120 = t118 + t119;
    T t134 = t132 - t133;
    T t110 = 1.15 * t105;
    T t112 = t103 - t105;
    T t123 = t12 * t120;
    T t135 = t12 * t134;
    T t121 = t19 * t120;
    T t139 = t32 * t134;
    T t111 = t10 * t110;
    T t113 = 0.465 * t112;
    T t122 = t21 * t110;
    T t127 = t20 * t110;
    T t131 = t26 * t110;
    T t140 = t121 + t139;
    T t172 = t32 * t110;
    T t166 = t19 * t110;
    T t114 = t23 + t111;
    T t124 = t122 - t123;
    T t128 = t27 - t127;
    T t136 = t131 + t135;
    T t115 = t113 + t114;
    T t125 = t122 + t124;
    T t129 = 190.25 * t128;
    T t137 = t131 + t136;
    T t116 = 190.25 * t115;
    T t126 = t24 * t125;
    T t130 = t26 * t129;
    T t138 = t28 * t137;
    T t173 = t12 * t129;
    T t148 = 88.46625 * t125;
    T t117 = t21 * t116;
    T t167 = t12 * t116;
    T t141 = t126 - t140;
    T t142 = t130 - t138;
    T t174 = t172 - t173;
    T t159 = t148 - t158;
    T t184 = t148 - t183;
    T t143 = t117 + t130;
    T t168 = t166 + t167;
    T t144 = t117 + t141;
    T t175 = t10 * t174;
    T t145 = t142 + t143;
    T t169 = t20 * t168;
    T t185 = t175 - t184;
    T t146 = t144 + t145;
    T t186 = t169 - t185;
    T t147 = 1.15 * t146;
    T t160 = t147 - t159;
    T t177 = t78 * t160;
    T t161 = t72 * t160;
    T t187 = t177 - t186;
    T t188 = t102 * t187;
    OUT(j_a, 1, -t188);
    T t189 = t78 * t188;
    T t190 = t161 - t189;
    OUT(j_a, 0, t190);
    return 0.0 * t103 + 0.0 * t105 + 0.0 * t188 + 0.0 * t190;
}
#endif
