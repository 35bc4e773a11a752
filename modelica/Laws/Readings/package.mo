within Laws;
package Readings "What an instrument does to a reading whose rate nothing gives"
end Readings;
