function yes = bdIsLoaded(name) %#ok<INUSD>
  yes = false;
end
