function run_once(parameters, signals)
  block = FakeBlock(999, parameters);
  block.set_up(@sfun_glrender);
  block.call('Start');
  done = onCleanup(@() block.call('Terminate'));
  block.output_at(0, signals{:});
end
