defmodule Situ.CLI.Store.ExternalFiles do
  @moduledoc false
  # External files have no checksums that Situ knows, so it verifies them by reading all their messages.
  alias Situ.CLI.Recording
  alias Situ.{Error, Store}
  alias Situ.Store.Undecoded

  @type report :: %{messages: non_neg_integer(), damage: [%{why: String.t()}]}

  @spec verify_file(Path.t(), (non_neg_integer(), non_neg_integer() -> any())) ::
          {:ok, report()} | {:error, Error.t()}
  def verify_file(path, progress) do
    Recording.load_formats([path])

    with {:ok, store} <- Store.open(path) do
      streams = Store.streams(store)
      total = streams |> Enum.map(& &1.count) |> Enum.sum()

      {read, damage} =
        Enum.reduce(streams, {0, []}, fn info, acc ->
          read_stream(store, info, acc, &progress.(&1, total))
        end)

      of_file =
        for position <- Store.info(store).damage,
            do: %{why: Situ.Recording.describe_damage(position)}

      {:ok, %{messages: read, damage: of_file ++ Enum.reverse(damage)}}
    end
  end

  defp read_stream(store, info, {read, damage}, progress) do
    {n, bad, why} =
      store
      |> Store.messages(info)
      |> Enum.reduce({0, 0, nil}, fn message, {n, bad, why} ->
        if rem(n, 1_000) == 0, do: progress.(read + n)

        case message.data do
          %Undecoded{reason: reason} -> {n + 1, bad + 1, why || reason}
          _ -> {n + 1, bad, why}
        end
      end)

    {read + n, undecoded_damage(info, bad, why) ++ damage}
  rescue
    error in Error -> {read, [%{why: "#{info.name}: #{Exception.message(error)}"} | damage]}
  end

  defp undecoded_damage(_info, 0, _why), do: []

  defp undecoded_damage(info, bad, why),
    do: [%{why: "#{info.name}: #{bad} messages do not match their schema (#{why})"}]
end
