// Reads a robot from the text file that peers_robots.py writes.
#ifndef PEERS_MODEL_HPP
#define PEERS_MODEL_HPP

#include <pinocchio/multibody.hpp>

#include <fstream>
#include <string>

namespace pin = pinocchio;

inline pin::Model read(const char *path)
{
    std::ifstream file(path);
    file.exceptions(std::ios::failbit | std::ios::badbit);
    pin::Model model;
    Eigen::Vector3d gravity;
    int joints = 0;
    file >> gravity[0] >> gravity[1] >> gravity[2] >> joints;
    model.gravity.linear() = gravity;
    pin::JointIndex parent = 0;
    for (int j = 0; j < joints; ++j) {
        std::string kind;
        file >> kind;
        double x[25]; // placement: position, rotation by rows; mass, centre of mass, inertia about
                      // it by rows
        for (double &number : x) {
            file >> number;
        }
        using Rows = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>;
        const pin::SE3 placement(Rows(x + 3), Eigen::Map<const Eigen::Vector3d>(x));
        const std::string name = "j" + std::to_string(j);
        if (kind == "RX") {
            parent = model.addJoint(parent, pin::JointModelRX(), placement, name);
        } else if (kind == "RY") {
            parent = model.addJoint(parent, pin::JointModelRY(), placement, name);
        } else if (kind == "RZ") {
            parent = model.addJoint(parent, pin::JointModelRZ(), placement, name);
        } else if (kind == "PX") {
            parent = model.addJoint(parent, pin::JointModelPX(), placement, name);
        } else if (kind == "PY") {
            parent = model.addJoint(parent, pin::JointModelPY(), placement, name);
        } else {
            parent = model.addJoint(parent, pin::JointModelPZ(), placement, name);
        }
        if (x[12] > 0.0) {
            const Eigen::Vector3d com(x[13], x[14], x[15]);
            const Eigen::Matrix3d about_com = Rows(x + 16);
            const pin::Inertia inertia(x[12], com, about_com);
            model.appendBodyToJoint(parent, inertia);
        }
    }
    return model;
}

#endif
