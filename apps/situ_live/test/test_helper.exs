alias Situ.Live.NodeTools

# Tests with Node and Chromium run wherever these are; `mix test --only browser` without them fails instead of skipping.
without_node = if NodeTools.installed?(), do: [], else: [:node, :browser]
without_chromium = if NodeTools.chromium(), do: [], else: [:browser]
excluded = Enum.uniq(without_node ++ without_chromium)

if excluded != [],
  do: IO.puts("left out for want of node, node_modules or chromium: #{inspect(excluded)}")

# What must come may take its time on a busy machine; what does not come fails all the same.
ExUnit.start(exclude: excluded, assert_receive_timeout: 30_000, timeout: 120_000)
