within Aero.Interfaces;
connector ForceInput = input Real(unit = "N") "Thrust of a propeller, given to what carries it";
