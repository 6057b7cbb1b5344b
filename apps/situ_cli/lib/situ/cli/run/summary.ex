defmodule Situ.CLI.Run.Summary do
  @moduledoc false
  # Counts the messages of a run, for the status line and for the report at the end.
  alias Situ.CLI.Output
  alias Situ.Diagnostics.Snapshot
  alias Situ.Pipeline.Report
  alias Situ.Time

  @enforce_keys [:name, :duration, :messages, :dropped, :skipped]
  defstruct [:name, :duration, :messages, :dropped, :skipped, :recording, :recorded_streams]

  @type t :: %__MODULE__{
          name: String.t(),
          duration: Time.duration(),
          messages: non_neg_integer(),
          dropped: non_neg_integer(),
          skipped: non_neg_integer(),
          recording: Path.t() | nil,
          recorded_streams: pos_integer() | nil
        }

  @doc "Summarizes a report. With `recorded?`, the pipeline was built by `Situ.CLI.Run.Recorder`."
  @spec new(Report.t(), boolean()) :: t()
  def new(%Report{} = report, recorded?) do
    {_, recording, streams} = if recorded?, do: report.result, else: {nil, nil, nil}
    {messages, dropped} = count_messages(report.snapshot)

    %__MODULE__{
      name: report.name,
      duration: report.duration,
      messages: messages,
      dropped: dropped,
      skipped: report.skipped |> Map.values() |> Enum.sum(),
      recording: recording,
      recorded_streams: streams
    }
  end

  # Each message counts once for every component that handles it.
  defp count_messages(%Snapshot{edges: edges}) do
    {edges |> Enum.map(& &1.processed) |> Enum.sum(),
     edges |> Enum.map(& &1.dropped) |> Enum.sum()}
  end

  @doc """
  Formats the state of a running pipeline as one line.

      iex> alias Situ.Diagnostics.{Edge, Snapshot}
      iex> Situ.CLI.Run.Summary.status_line(%Snapshot{
      ...>   pipeline: "Lobby", time: 72_000_000_000, progress: 0.25,
      ...>   edges: [%Edge{processed: 1_200, dropped: 3}]
      ...> })
      "Lobby  1 min 12 s  25 %  1200 messages handled  3 dropped"
  """
  @spec status_line(Snapshot.t()) :: String.t()
  def status_line(%Snapshot{} = snapshot) do
    {messages, dropped} = count_messages(snapshot)

    [
      snapshot.pipeline,
      Time.format_duration(snapshot.time - snapshot.start_time),
      if(snapshot.progress > 0, do: "#{trunc(snapshot.progress * 100)} %"),
      "#{Output.format_count(messages, "message")} handled",
      if(dropped > 0, do: "#{dropped} dropped")
    ]
    |> Enum.reject(&is_nil/1)
    |> Enum.join("  ")
  end

  @doc "Prints the summary, as JSON with `json: true`, or not at all with `quiet: true`."
  @spec print(t(), keyword()) :: :ok
  def print(%__MODULE__{} = summary, opts) do
    cond do
      opts[:json] -> summary |> Map.from_struct() |> Output.print_json()
      opts[:quiet] -> :ok
      true -> summary |> format_lines() |> Enum.each(&Output.puts/1)
    end
  end

  defp format_lines(summary) do
    losses =
      for {count, word} <- [
            {summary.dropped, "dropped"},
            {summary.skipped, "skipped after errors"}
          ],
          count > 0,
          do: ", #{count} #{word}"

    ended =
      "#{summary.name} ended after #{Time.format_duration(summary.duration)}: " <>
        "#{Output.format_count(summary.messages, "message")} handled#{losses}"

    [ended | recording_lines(summary)]
  end

  defp recording_lines(%{recording: nil}), do: []

  defp recording_lines(summary) do
    [
      "Recorded #{Output.format_count(summary.recorded_streams, "stream")} in #{summary.recording}",
      "Show it: situ studio #{summary.recording}"
    ]
  end
end
