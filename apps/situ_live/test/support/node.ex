defmodule Situ.Live.NodeTools do
  @moduledoc false
  # Runs Node with assets/node_modules and a bundle built once, for the tests with the unmodified JavaScript clients.

  @assets Path.expand("../../assets", __DIR__)

  @spec installed?() :: boolean()
  def installed?,
    do: System.find_executable("node") != nil and File.dir?(Path.join(@assets, "node_modules"))

  @spec chromium() :: String.t() | nil
  def chromium,
    do: System.find_executable("chromium") || System.find_executable("chromium-browser")

  @spec bundle!() :: Path.t()
  def bundle! do
    out = Path.join(System.tmp_dir!(), "situ_live_#{System.pid()}")
    File.mkdir_p!(out)

    {_, 0} =
      System.cmd("node", [Path.join(@assets, "test/bundle.mjs"), out], stderr_to_stdout: true)

    out
  end

  @spec run(Path.t(), [String.t()], keyword()) :: {String.t(), non_neg_integer()}
  def run(script, args, opts \\ []) do
    script = if Path.type(script) == :absolute, do: script, else: Path.join(@assets, script)
    System.cmd("node", [script | args], [stderr_to_stdout: true] ++ opts)
  end
end
