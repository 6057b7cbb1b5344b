defmodule Situ.Link.SecretsTest do
  # Logs, dumps and observers show the state of processes.
  use ExUnit.Case, async: true
  import Situ.Test.LinkRecordings
  alias Situ.Link

  @token "the-right-token-of-this-test"

  # Returns the states of all processes of this app.
  defp process_states do
    for pid <- Process.list(),
        {:dictionary, dictionary} <- [Process.info(pid, :dictionary)],
        link?(dictionary[:"$initial_call"]),
        do: inspect(:sys.get_state(pid, 5_000), limit: :infinity, printable_limit: :infinity)
  catch
    # The process ended in between.
    :exit, _ -> process_states()
  end

  defp link?({module, _, _}),
    do: module |> Atom.to_string() |> String.starts_with?("Elixir.Situ.Link.")

  defp link?(_none), do: false

  test "no process of a link shows the token" do
    root = folder()
    begin(root, "lobby", %{"n" => messages(1..50)})
    server = serve(Path.join(root, "lobby"), token: @token)
    address = address(server)

    # A recording that is being read, and a link that remains open.
    {:ok, store} = Situ.Store.open(address, reader_opts: [token: @token])
    assert Situ.Store.count(store, "n") == 50
    parent = self()

    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Link.open(address, token: @token, from: :start)
        |> Link.stream("n")
        |> Situ.each(&send(parent, {:got, &1}))
      end)

    assert_receive {:got, _}, 10_000

    states = process_states()
    assert length(states) >= 4
    for state <- states, do: refute(state =~ @token)
    Situ.Pipeline.stop(pipeline)
  end
end
