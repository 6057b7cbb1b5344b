defmodule Situ.Store.Csv.ColumnCopy do
  @moduledoc false
  # Appends columns of a CSV file to streams of a store. Native code handles many rows of all columns at a time. A part
  # that it cannot read (an unusual date format, an integer of more than 64 bits) is appended as messages.
  alias Situ.Store.Csv.Scan
  alias Situ.Store.{StreamInfo, Writer}

  @enforce_keys [:scan, :parts, :targets, :interval, :messages, :report_progress]
  defstruct @enforce_keys

  @type target :: {StreamInfo.t(), Writer.Stream.t()}
  @type t :: %__MODULE__{
          scan: Scan.t(),
          parts: tuple(),
          targets: [target()],
          interval: {Situ.Time.t(), Situ.Time.t()},
          messages: (StreamInfo.t(), non_neg_integer() -> {:ok, [Situ.Message.t()]} | error()),
          report_progress: (pos_integer() -> any())
        }
  @typep error :: {:error, String.t() | Situ.Error.t()}

  @doc """
  Appends the parts, starting with number `at`. `messages` returns the messages of a stream in a part. An error that is
  a string describes a problem in the file.
  """
  @spec append_parts(t(), non_neg_integer()) :: :ok | error()
  def append_parts(%{targets: []}, _at), do: :ok
  def append_parts(%{parts: parts}, at) when at >= tuple_size(parts), do: :ok

  def append_parts(%{interval: {_, to}} = job, at) do
    part = elem(job.parts, at)

    if part.last != nil and part.last >= to,
      do: :ok,
      else: append_part(job, at, part)
  end

  defp append_part(job, at, part) do
    targets =
      for {info, stream} <- job.targets,
          do: {info.id - 1, stream, fields_before(job, info, at) + 1}

    case Scan.append_columns(job.scan, part, targets, job.interval) do
      {:ok, parts, counts} -> append_rest(job, at, at + parts, counts)
      :slow -> append_messages(job, at)
      error -> error
    end
  end

  defp append_rest(job, at, next, counts) do
    expected =
      for {info, _} <- job.targets,
          do: fields_before(job, info, next) - fields_before(job, info, at)

    if Enum.map(counts, &elem(&1, 0)) == expected do
      report_count(job, counts |> Enum.map(&elem(&1, 1)) |> Enum.sum())
      append_parts(job, next)
    else
      {:error, "the number of fields in a column has changed"}
    end
  end

  defp append_messages(job, at) do
    {from, to} = job.interval

    result =
      Enum.reduce_while(job.targets, {:ok, 0}, fn {info, stream}, {:ok, sum} ->
        with {:ok, messages} <- job.messages.(info, at),
             messages = Enum.filter(messages, &(&1.originating_time in from..to)),
             {:ok, _stream} <- Writer.append(stream, messages) do
          {:cont, {:ok, sum + length(messages)}}
        else
          error -> {:halt, error}
        end
      end)

    with {:ok, sum} <- result do
      report_count(job, sum)
      append_parts(job, at + 1)
    end
  end

  defp report_count(_job, 0), do: :ok
  defp report_count(job, n), do: job.report_progress.(n)

  # Counts the fields of a stream's column before a part.
  defp fields_before(%{parts: parts}, info, at) when at >= tuple_size(parts), do: info.count

  defp fields_before(job, info, at), do: Map.get(elem(job.parts, at).counts, info.id - 1, 0)
end
