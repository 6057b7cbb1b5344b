defmodule Situ.Media.FileTime do
  @moduledoc false
  # Converts media time (0 at the start of a file) to originating time, by the option `start_time:` of every source that
  # reads a file. The pipeline's clock begins at the file's time unless the option is `:pipeline`.

  @type start_time :: :file | :pipeline | Situ.Time.t()

  @doc "Returns the schema entry of the option."
  @spec start_time_option() :: keyword()
  def start_time_option do
    [
      type: {:or, [{:in, [:file, :pipeline]}, :integer]},
      default: :file,
      doc:
        "Originating time of the start of the file, ns. `:file`: the file's own time, which is exact for recordings " <>
          "written by Situ, and for other files their creation time (or the epoch if the file does not state it). " <>
          "`:pipeline`: the first data read gets the time at which the pipeline starts, as if it were live."
    ]
  end

  @doc """
  Returns the offset to add to media times, for a file recorded at `recorded_at` and read from
  `start`.

      iex> Situ.Media.FileTime.time_offset(:pipeline, nil, Situ.Time.s(3), %{start_time: Situ.Time.s(100)})
      97_000_000_000
      iex> Situ.Media.FileTime.time_offset(:file, nil, 0, %{start_time: 5})
      0
  """
  @spec time_offset(start_time(), Situ.Time.t() | nil, Situ.Time.t(), %{
          :start_time => Situ.Time.t(),
          optional(atom()) => term()
        }) ::
          Situ.Time.t()
  def time_offset(:pipeline, _recorded_at, start, %{start_time: now}), do: now - start
  def time_offset(:file, recorded_at, _start, _context), do: recorded_at || 0
  def time_offset(time, _recorded_at, _start, _context) when is_integer(time), do: time

  @doc "Proposes the span of the file to the pipeline for replay, unless `start_time` is `:pipeline`."
  @spec propose_replay(
          Situ.Pipeline.t(),
          start_time(),
          Situ.Time.t() | nil,
          {integer(), integer() | nil}
        ) ::
          :ok
  def propose_replay(_pipeline, :pipeline, _recorded_at, _span), do: :ok

  def propose_replay(pipeline, start_time, recorded_at, {from, to}) do
    zero = time_offset(start_time, recorded_at, from, %{start_time: 0})
    Situ.Pipeline.propose_replay(pipeline, {zero + from, if(to, do: zero + to, else: :unbounded)})
  end

  @doc """
  Returns the span of the file to read: the span from the options, clipped to the pipeline's replay interval.

      iex> Situ.Media.FileTime.read_span(100, {10, nil}, %{start_time: 130, replay_end: 150})
      {30, 51}
  """
  @spec read_span(Situ.Time.t(), {integer(), integer() | nil}, map()) ::
          {integer(), integer() | nil}
  def read_span(offset, {from, to}, %{start_time: start, replay_end: replay_end}) do
    last = if is_integer(replay_end), do: replay_end - offset + 1

    {max(from, start - offset),
     case {to, last} do
       {nil, last} -> last
       {to, nil} -> to
       {to, last} -> min(to, last)
     end}
  end
end
