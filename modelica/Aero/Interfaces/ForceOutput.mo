within Aero.Interfaces;
connector ForceOutput = output Real(unit = "N") "Thrust of a propeller, given to what carries it";
