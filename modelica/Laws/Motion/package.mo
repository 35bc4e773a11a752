within Laws;
package Motion "Forces and torques that a motion meets"
end Motion;
