defmodule Situ.Store.S3.Transfer do
  @moduledoc false
  # Copies several recordings one after the other, and reports their names and the cost.
  alias Situ.Error
  alias Situ.Store.Folder
  alias Situ.Store.S3.{Address, Cost, Listing, Pull, Push}

  @typedoc """
  The names of the copied recordings, of recordings that existed already, of recordings that are not finished, and of
  deleted recordings. The cost: `reads` (GET and HEAD requests), `writes` (PUT, POST and LIST requests), `deletes`, and
  the bytes `sent` and `received`.
  """
  @type report :: %{
          copied: [String.t()],
          present: [String.t()],
          unfinished: [Path.t()],
          deleted: [String.t()],
          cost: %{atom() => non_neg_integer()}
        }

  @doc "Runs a transfer and adds its cost to its report."
  @spec run((() -> {:ok, report()} | {:error, Error.t()})) ::
          {:ok, report()} | {:error, Error.t()}
  def run(transfer) do
    case Cost.measure(transfer) do
      {{:ok, report}, cost} -> {:ok, %{report | cost: cost}}
      {error, _} -> error
    end
  end

  @doc "Returns the report of a transfer that did nothing."
  @spec empty_report() :: report()
  def empty_report, do: %{copied: [], present: [], unfinished: [], deleted: [], cost: %{}}

  @doc "Uploads stores."
  @spec push_jobs([Push.job()], [Path.t()], Push.progress() | nil) ::
          {:ok, report()} | {:error, Error.t()}
  def push_jobs(jobs, unfinished, progress) do
    sizes = for {path, _} <- jobs, do: Folder.total_size(path)
    total = Enum.sum(sizes)

    steps =
      for {{path, address}, before} <- Enum.zip(jobs, sums_before(sizes)) do
        report = fn done, _ -> if progress, do: progress.(before + done, total) end
        {Address.format(address), fn -> Push.push_store(path, address, report) end}
      end

    run_steps(steps, %{empty_report() | unfinished: unfinished})
  end

  defp sums_before(sizes), do: [0 | Enum.scan(sizes, &+/2)]

  @doc "Downloads stores."
  @spec pull_jobs([{Listing.item(), Path.t()}], Push.progress() | nil) ::
          {:ok, report()} | {:error, Error.t()}
  def pull_jobs(jobs, progress) do
    count = length(jobs)
    before = :counters.new(1, [])

    steps =
      for {{item, folder}, index} <- Enum.with_index(jobs) do
        {folder,
         fn ->
           start = :counters.get(before, 1)

           # The sizes of later recordings are not known yet, so this size is used for them.
           Pull.pull_store(item, folder, fn done, total ->
             :counters.put(before, 1, start + done)
             if progress, do: progress.(start + done, start + total * (count - index))
           end)
         end}
      end

    run_steps(steps, empty_report())
  end

  defp run_steps(steps, report) do
    Enum.reduce_while(steps, {:ok, report}, fn {name, step}, {:ok, report} ->
      case step.() do
        {:ok, :copied} -> {:cont, {:ok, %{report | copied: report.copied ++ [name]}}}
        {:ok, :present} -> {:cont, {:ok, %{report | present: report.present ++ [name]}}}
        error -> {:halt, error}
      end
    end)
  end
end
