defmodule Situ.Pipeline.AbandonTest do
  use ExUnit.Case, async: false
  import ExUnit.CaptureLog

  defmodule Holder do
    use Situ.Component, inputs: [in: :any], options: [told: [type: :pid, required: true]]

    @impl true
    def init(opts), do: {:ok, opts[:told]}

    @impl true
    def handle_message(:in, message, _context, told) do
      send(told, {:got, message.data})
      {[], told}
    end

    @impl true
    def terminate(reason, told), do: send(told, {:released, reason})
  end

  test "components release their resources, nothing more is delivered, and nothing is logged" do
    me = self()

    build = fn p ->
      numbers = Situ.from_enumerable(p, Stream.iterate(1, &(&1 + 1)), every: Situ.Time.ms(1))
      Situ.via(numbers, Holder, told: me)
    end

    quiet =
      capture_log(fn ->
        {:ok, p} = Situ.Pipeline.start(build)
        assert_receive {:got, 1}, 5_000
        monitor = Process.monitor(p)
        assert :ok = Situ.Pipeline.abandon(p)
        assert_receive {:DOWN, ^monitor, :process, _, {:shutdown, :abandoned}}, 5_000
        assert_receive {:released, _}, 5_000
        assert {:error, %{code: :abandoned}} = Situ.Pipeline.await(p)
        assert {:error, %{code: :not_running}} = Situ.Pipeline.abandon(p)
      end)

    assert quiet == ""
  end
end
