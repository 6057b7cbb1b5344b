defmodule Situ.Examples.Demo.Options do
  @moduledoc false
  # Parses the demo's command line.

  @switches [
    input: :string,
    truth: :string,
    out: :string,
    headless: :boolean,
    open: :boolean,
    json: :boolean,
    profile: :boolean,
    transcript: :boolean,
    realtime: :boolean,
    seconds: :float,
    port: :integer,
    help: :boolean
  ]

  @spec parse([String.t()]) :: {:ok, keyword()} | :help | {:error, String.t()}
  def parse(argv) do
    # `elixir -e ... -- args` passes the dashes to the script.
    argv = if List.first(argv) == "--", do: tl(argv), else: argv

    case OptionParser.parse(argv, strict: @switches, aliases: [h: :help]) do
      {_, _, [{switch, _} | _]} -> {:error, "unknown or incomplete option #{switch}"}
      {_, [extra | _], _} -> {:error, "unexpected argument #{extra}"}
      {opts, [], []} -> if opts[:help], do: :help, else: {:ok, complete_options(opts)}
    end
  end

  defp complete_options(opts) do
    input = resolve_input(opts[:input])
    live? = not File.exists?(input) or String.starts_with?(input, "/dev/")

    [out: "recordings", port: 4040, open: true]
    |> Keyword.merge(opts)
    |> Keyword.merge(input: input, live: live? and device_name?(input))
    |> Keyword.put(:policy, if(live? and device_name?(input), do: Situ.Delivery.latest()))
  end

  defp device_name?(input), do: input =~ ~r{^(/dev/|[a-z0-9]+:)}

  defp resolve_input(nil), do: default_clip()
  defp resolve_input("camera"), do: "/dev/video0"
  defp resolve_input(other), do: other

  @doc "Returns the path of the clip included with the examples."
  @spec default_clip() :: Path.t()
  def default_clip,
    do: Path.join([to_string(:code.priv_dir(:situ_examples)), "demo", "talk1.mp4"])
end
