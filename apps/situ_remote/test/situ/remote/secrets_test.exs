defmodule Situ.Remote.SecretsTest do
  # Logs, dumps and observers show the states of processes.
  use ExUnit.Case, async: true
  import Situ.Remote.Test.Recordings
  alias Situ.Remote

  @token "the-right-token-of-this-test"

  # Everything that the processes of this app, and what was started here, keep.
  defp kept do
    for pid <- Process.list(),
        {:dictionary, dictionary} <- [Process.info(pid, :dictionary)],
        match?({Situ.Remote, _, _}, named(dictionary[:"$initial_call"])),
        do:
          {pid, inspect(:sys.get_state(pid, 5_000), limit: :infinity, printable_limit: :infinity)}
  catch
    # One that has ended meanwhile.
    :exit, _ -> kept()
  end

  defp named({module, function, arity}) do
    case Module.split(module) do
      ["Situ", "Remote" | _] -> {Situ.Remote, function, arity}
      _ -> nil
    end
  rescue
    ArgumentError -> nil
  end

  defp named(_), do: nil

  test "no process of a link shows the token" do
    root = folder()
    begin(root, "lobby", %{"n" => messages(1..50)})
    server = serve(Path.join(root, "lobby"), token: @token)
    address = address(server)

    # A recording that is read, and a link that stays open.
    {:ok, store} = Situ.Store.open(address, reader_opts: [token: @token])
    assert Situ.Store.count(store, "n") == 50
    parent = self()

    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Remote.open(address, token: @token, from: :start)
        |> Remote.stream("n")
        |> Situ.each(&send(parent, {:got, &1}))
      end)

    assert_receive {:got, _}, 10_000

    states = kept()
    assert length(states) >= 4
    for {_, shown} <- states, do: refute(shown =~ @token)
    Situ.Pipeline.stop(pipeline)
  end
end
