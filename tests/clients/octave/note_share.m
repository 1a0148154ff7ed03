function note_share(told, share)
  % Note a share in a Map.
  told('shares') = [told('shares'), share];
end
