function expect_error(identifier, pattern, call)
  % The call must raise this identifier, with a message that matches.
  try
    call();
  catch problem
    check(strcmp(problem.identifier, identifier), 'expected %s, got %s: %s', identifier, problem.identifier, ...
          problem.message);
    check(~isempty(regexp(problem.message, pattern, 'once')), 'message "%s" has no "%s"', problem.message, pattern);
    return
  end
  error('check:failed', 'expected %s, got no error', identifier);
end
