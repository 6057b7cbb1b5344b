defmodule Situ.Simulation.Trace do
  @moduledoc false
  # Describes the steps of a simulation. Processes have their names and references are left out, so that the same
  # schedule has the same trace in every run.
  alias Situ.Delivery.Batch

  @type names :: %{pid() => String.t()}

  @spec describe_event(term(), names()) :: String.t()
  def describe_event(:ended, _names), do: "ends"
  def describe_event(:killed, _names), do: "is killed"
  def describe_event({:waits, :new}, _names), do: "starts, and waits"
  def describe_event({:waits, :waits}, _names), do: "continues, and waits again"
  def describe_event({:waits, :rests}, _names), do: "waits in the middle of a message"

  def describe_event({:timer, message}, names),
    do: "a timer sends it " <> describe_message(message, names)

  def describe_event({:handled, :started}, _names), do: "starts"
  def describe_event({:handled, :nothing}, _names), do: "has nothing to do"
  def describe_event({:handled, :system}, _names), do: "shows its state"

  def describe_event({:handled, message}, names),
    do: "handles " <> describe_message(message, names)

  defp describe_message(
         {:"$gen_consumer", {pid, _tag}, {:cancel, {:shutdown, {:closed, time}}}},
         names
       ),
       do: "the end of the stream from #{name(names, pid)} at #{time}"

  defp describe_message({:"$gen_consumer", {pid, _tag}, {:cancel, _reason}}, names),
    do: "the end of the subscription to #{name(names, pid)}"

  defp describe_message({:"$gen_consumer", {pid, _tag}, batches}, names) when is_list(batches),
    do: "#{count_messages(batches)} from #{name(names, pid)}"

  defp describe_message({:"$gen_consumer", {pid, _tag}, {:fresh, messages}}, names),
    do: "#{count(length(messages), "newest message")} from #{name(names, pid)}"

  defp describe_message({:"$gen_producer", {pid, _tag}, {:ask, n}}, names),
    do: "the demand #{n} of #{name(names, pid)}"

  defp describe_message({:situ_stage, id, event}, names),
    do: "the report of stage #{id}: #{inspect_term(event, names)}"

  # To one stage of a shared process.
  defp describe_message({:situ, {:to, _id, request}}, names),
    do: describe_message({:situ, request}, names)

  defp describe_message({:situ, request}, names)
       when is_tuple(request) and elem(request, 0) == :start,
       do:
         "the request to start" <>
           if(tuple_size(request) > 2, do: inspect_term(request, names), else: "")

  defp describe_message({:situ, request}, names),
    do: "the request " <> inspect_term(request, names)

  defp describe_message(:situ_turn, _names), do: "its next time slice"
  defp describe_message({:situ_alarm, time}, _names), do: "its alarm for #{time}"

  defp describe_message({:"$gen_call", {pid, _tag}, request}, names),
    do: "the call #{inspect_term(request, names)} of #{name(names, pid)}"

  defp describe_message({:EXIT, pid, reason}, names),
    do: "the end of #{name(names, pid)}: #{inspect_term(reason, names)}"

  defp describe_message({:DOWN, _ref, :process, pid, reason}, names),
    do: "the end of #{name(names, pid)}: #{inspect_term(reason, names)}"

  defp describe_message(message, names), do: inspect_term(message, names)

  defp count_messages(batches),
    do: batches |> Enum.map(&count_batch/1) |> Enum.sum() |> count("message")

  defp count_batch(messages) when is_list(messages), do: length(messages)
  defp count_batch(batch), do: Batch.size(batch)

  defp count(1, what), do: "1 #{what}"
  defp count(n, what), do: "#{n} #{what}s"

  defp inspect_term(term, names) do
    term |> replace(names, 3) |> inspect(limit: 8, printable_limit: 60, structs: false)
  end

  # Parts that are not shown are left out.
  defp replace(pid, names, _depth) when is_pid(pid), do: String.to_atom(name(names, pid))
  defp replace(term, _names, _depth) when is_reference(term) or is_port(term), do: :ref
  defp replace(term, _names, _depth) when is_function(term), do: :function

  defp replace(%{what: what, code: code, __struct__: Situ.Error}, _names, _depth),
    do: {:error, code, what}

  defp replace(%module{}, _names, _depth), do: module
  defp replace(term, _names, 0) when is_tuple(term) or is_list(term) or is_map(term), do: :...

  defp replace([head | tail], names, depth) when is_list(tail),
    do: for(item <- Enum.take([head | tail], 8), do: replace(item, names, depth - 1))

  defp replace(term, names, depth) when is_tuple(term),
    do: term |> Tuple.to_list() |> Enum.map(&replace(&1, names, depth - 1)) |> List.to_tuple()

  defp replace(term, names, depth) when is_map(term),
    do:
      Map.new(Enum.take(term, 8), fn {key, value} ->
        {replace(key, names, 1), replace(value, names, depth - 1)}
      end)

  defp replace(term, _names, _depth), do: term

  defp name(names, pid), do: Map.get(names, pid, "a process outside")
end
