defmodule Situ.Examples.Demo.SceneCommand do
  @usage """
  Usage: bin/demo --scene [--seconds N] [--out FOLDER] [--headless] [--json] [--fast]

  Simulates a room with two people, a depth camera and a microphone. Records points, bodies, pointing gestures,
  detections, voice activity and latencies, and then serves the studio on the recording, in one layout.

    --seconds N      duration to record (default: 12)
    --out FOLDER     folder for the recording (default: "recordings")
    --fast           run as fast as possible instead of in real time; latencies are then meaningless
    --headless       do not serve the studio afterwards
    --json           print one JSON object and nothing else
    --port N         port of the studio (default 4040; 0 picks a free port)
    --no-open        do not open a browser

  Exit status: 0 success, 1 failure, 2 wrong usage.
  """
  @moduledoc """
  The `bin/demo --scene` command: records `Situ.Examples.Scene` and opens its layout in the studio.

  ```text
  #{@usage}
  ```
  """
  alias Situ.{Error, Store}
  alias Situ.Examples.Demo.CommandLine
  alias Situ.Examples.Scene

  @switches [
    scene: :boolean,
    seconds: :float,
    out: :string,
    fast: :boolean,
    headless: :boolean,
    json: :boolean,
    port: :integer,
    open: :boolean,
    help: :boolean
  ]
  @layout "Scene"

  @doc "Runs the demo and returns the exit status."
  @spec run([String.t()]) :: 0 | 1 | 2
  def run(argv) do
    command = %{name: "bin/demo --scene", usage: @usage, switches: @switches}
    CommandLine.run(argv, command, &record_and_serve/1)
  end

  @doc """
  Records the room. Options are `seconds:`, `out:` and `fast:`. `result.path` of the report is the path of the
  recording.
  """
  @spec record_room(keyword()) :: {:ok, Situ.Pipeline.Report.t()} | {:error, Error.t()}
  def record_room(opts) do
    {:ok, _} = Application.ensure_all_started(:situ_examples)
    speed = if opts[:fast], do: :max, else: 1.0
    now = System.os_time(:nanosecond)
    seconds = opts[:seconds] || 12.0

    settings = [
      name: "Scene",
      replay: [speed: speed, interval: {now, now + round(seconds * 1.0e9)}]
    ]

    Situ.Pipeline.run(Scene,
      pipeline: settings,
      path: opts[:out] || "recordings",
      seconds: seconds
    )
  end

  defp record_and_serve(opts) do
    case record_room(opts) do
      {:ok, %{result: %{path: path}}} ->
        IO.puts(format_recording(path, opts))
        if opts[:headless], do: 0, else: serve_studio(path, opts)

      {:error, error} ->
        CommandLine.print_error(error)
    end
  end

  defp format_recording(path, opts) do
    store = Store.open!(path)
    streams = for s <- Store.streams(store), do: {s.name, s.count}
    if opts[:json], do: encode_streams(path, streams), else: format_streams(path, streams)
  end

  defp encode_streams(path, streams),
    do: Situ.JSON.encode(%{"recording" => path, "streams" => Map.new(streams)})

  defp format_streams(path, streams) do
    width = streams |> Enum.map(fn {name, _} -> String.length(name) end) |> Enum.max()

    rows =
      for {name, count} <- Enum.sort(streams),
          do: "  #{String.pad_trailing(name, width)}  #{count}\n"

    ["Recorded #{path}\n", rows]
  end

  @doc "Copies the layout to a folder that the studio can load, and returns the folder."
  @spec write_layout_folder(Path.t()) :: Path.t()
  def write_layout_folder(path) do
    folder = path <> ".layouts"
    File.mkdir_p!(folder)
    shipped = Path.join([to_string(:code.priv_dir(:situ_examples)), "scene", "scene.json"])
    File.cp!(shipped, Path.join(folder, "scene.json"))
    folder
  end

  defp serve_studio(path, opts) do
    case Situ.Studio.start_link(
           path: path,
           port: opts[:port] || 4040,
           layouts: write_layout_folder(path)
         ) do
      {:ok, studio} ->
        url = Situ.Studio.url(studio, Situ.Studio.only_item(studio))
        url = url <> if(url =~ "?", do: "&", else: "?") <> "layout=#{@layout}"
        IO.puts(:stderr, "The room is at #{url} (Ctrl-C to stop)")
        if opts[:open] != false, do: Situ.CLI.Desktop.open_url(url)
        Process.sleep(:infinity)

      {:error, error} ->
        CommandLine.print_error(error)
    end
  end
end
