defmodule Situ.Pipeline.Dynamic.ReplacementTest do
  use ExUnit.Case, async: true

  alias Situ.{Connector, Message, Pipeline}

  defmodule Gain do
    # Multiplies and numbers its messages; the count survives a replacement.
    use Situ.Component,
      inputs: [in: :integer],
      outputs: [out: :any],
      options: [factor: [type: :integer, default: 1]]

    @impl true
    def init(opts), do: {:ok, {opts[:factor], 0}}

    @impl true
    def handle_message(:in, message, _context, {factor, n}),
      do: {[{:out, message.originating_time, {n, message.data * factor}}], {factor, n + 1}}

    @impl true
    def migrate({_factor, n}, _old, new), do: {:ok, {new[:factor], n}}
  end

  defmodule Other do
    use Situ.Component, inputs: [in: :integer], outputs: [out: :any]

    @impl true
    def handle_message(:in, message, _context, state),
      do: {[{:out, message.originating_time, {:other, message.data}}], state}
  end

  defmodule Text do
    use Situ.Component, inputs: [in: :string], outputs: [out: :any]
  end

  setup do
    me = self()
    connector = Connector.new("in")

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Connector.receive(connector, type: :integer)
          |> Situ.via(Gain, factor: 2, name: "Gain")
          |> Situ.map(& &1, name: "Same")
          |> Situ.each(&send(me, {:got, &1}))
        end,
        []
      )

    :ok = Connector.await_open(connector, 30_000)
    %{p: p, connector: connector}
  end

  test "new options keep the state, and no message is lost, duplicated or reordered",
       %{p: p} = c do
    post(c, 0..999)
    assert_receive {:got, first}
    :ok = Pipeline.replace(p, "Gain", factor: 3)
    post(c, 1_000..1_999)
    {:ok, _} = Pipeline.stop(p)
    got = [first | got()]
    assert Enum.map(got, &elem(&1, 0)) == Enum.to_list(0..1_999)
    factors = for {n, v} <- got, n > 0, do: div(v, n)
    assert Enum.dedup(factors) == [2, 3]
    assert length(factors) == 1_999
  end

  test "a different module with matching ports starts fresh without migrate/3", %{p: p} = c do
    :ok = Pipeline.replace(p, "Gain", {Other, []})
    post(c, 0..2)
    assert Enum.any?(Pipeline.info(p).nodes, &(&1.module =~ "Other"))
    {:ok, _} = Pipeline.stop(p)
    assert got() == [other: 0, other: 1, other: 2]
  end

  test "replaces an operator's function", %{p: p} = c do
    :ok = Pipeline.replace(p, "Same", {:map, fn {n, v} -> {n, -v} end})
    post(c, 1..2)
    {:ok, _} = Pipeline.stop(p)
    assert got() == [{0, -2}, {1, -4}]
  end

  test "refuses an invalid replacement with a reason and changes nothing", %{p: p} = c do
    assert {:error, %{code: :type_mismatch, what: what}} = Pipeline.replace(p, "Gain", {Text, []})
    assert what =~ "Gain"
    assert {:error, %{code: :unknown_option}} = Pipeline.replace(p, "Gain", factr: 3)
    assert {:error, %{code: :not_a_component}} = Pipeline.replace(p, "Gain", {String, []})

    assert {:error, %{code: :unknown_component, fix: fix}} =
             Pipeline.replace(p, "Gian", factor: 3)

    assert fix =~ "Gain"
    assert {:error, %{code: :bad_replacement}} = Pipeline.replace(p, "Same", {:filter, & &1})
    post(c, 1..1)
    {:ok, _} = Pipeline.stop(p)
    assert got() == [{0, 2}]
    assert {:error, %{code: :not_running}} = Pipeline.replace(p, "Gain", factor: 3)
  end

  defp post(%{connector: connector}, values) do
    Connector.deliver_messages(
      connector,
      for(v <- values, do: %Message{data: v, originating_time: v})
    )
  end

  defp got do
    receive do
      {:got, v} -> [v | got()]
    after
      0 -> []
    end
  end
end
