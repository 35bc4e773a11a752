within Laws;
package Inputs "What an actuator does to the model's input"
end Inputs;
