alias Situ.Live.NodeTools

# Tests with Node and Chromium run if these are installed; without them, `mix test --only browser` fails instead of
# skipping.
without_node = if NodeTools.installed?(), do: [], else: [:node, :browser]
without_chromium = if NodeTools.chromium(), do: [], else: [:browser]
excluded = Enum.uniq(without_node ++ without_chromium)

if excluded != [],
  do:
    IO.puts("not tested, because node, node_modules or chromium is missing: #{inspect(excluded)}")

# A busy machine may deliver an expected message late; a missing message still fails the test.
ExUnit.start(exclude: excluded, assert_receive_timeout: 30_000, timeout: 120_000)
