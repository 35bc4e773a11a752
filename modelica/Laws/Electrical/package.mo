within Laws;
package Electrical "Voltages in series with a current"
end Electrical;
