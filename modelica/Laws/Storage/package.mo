within Laws;
package Storage "Flows that leave a storage"
end Storage;
