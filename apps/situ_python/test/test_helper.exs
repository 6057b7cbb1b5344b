# Debian's python3-numpy, or another interpreter: SITU_TEST_PYTHON=.venv/bin/python.
numpy? = Situ.PythonPrograms.numpy?()

unless numpy? do
  IO.puts(
    "SKIPPED: arrays in Python components (#{Situ.PythonPrograms.numpy_python()} has no numpy)"
  )
end

# A busy machine may deliver an expected message late. A missing message still fails the test.
ExUnit.start(
  assert_receive_timeout: 30_000,
  timeout: 120_000,
  exclude: if(numpy?, do: [], else: [:numpy])
)
