within Laws;
package Outputs "What an instrument does to a reading"
end Outputs;
