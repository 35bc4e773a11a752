within Laws;
package Interfaces "Partial models: what a law is given and what it gives"
end Interfaces;
