defmodule Situ.Fusion.MergeComponent do
  @moduledoc false
  # The component of merge. It emits complete messages in order of arrival, with the clock's time. Inputs can be added
  # and removed.
  use Situ.Component,
    share_process: true,
    inputs: [],
    outputs: [out: Situ.Message],
    options: [members: [type: :list, required: true, doc: "`{input, key}` of each member."]]

  alias Situ.Fusion.InputKeys
  alias Situ.Options

  @impl true
  def init(opts), do: {:ok, {nil, opts[:members]}}

  @impl true
  def handle_message(_input, message, context, {last, members}) do
    time = if last == nil, do: context.now, else: max(context.now, last + 1)
    {[{:out, time, message}], {time, members}}
  end

  @impl true
  def handle_attach(input, {key, opts}, last, _context, {reached, members}) do
    with {:ok, []} <- Options.validate(opts, []),
         :ok <- InputKeys.check_free(member_keys(members), key) do
      members = members ++ [{input, key}]
      from = if last == nil, do: :start, else: last + 1
      {:ok, from, [members: members], [], {reached, members}}
    end
  end

  @impl true
  def handle_detach({key, opts}, context, {reached, members}) do
    with {:ok, []} <- Options.validate(opts, []), {:ok, input} <- fetch_input(members, key) do
      opts = [members: List.keydelete(members, input, 0)]
      {:ok, context.now, opts, [{:detach, input, opts}], {reached, opts[:members]}}
    end
  end

  defp member_keys(members), do: Enum.map(members, &elem(&1, 1))

  defp fetch_input(members, key) do
    case List.keyfind(members, key, 1) do
      {input, _} -> {:ok, input}
      nil -> InputKeys.unknown_key_error(member_keys(members), key)
    end
  end
end
