defmodule {{Module}}Test do
  use ExUnit.Case, async: true
  alias Situ.{Store, Time}
  alias {{Module}}.Knocks

  # `Situ.Test` runs on a virtual clock: nothing waits, and every run has the same result.
  test "reports a knock once, and the next one after the quiet time" do
    level = [{0, 0.1}, {Time.ms(100), 0.9}, {Time.ms(200), 0.8}, {Time.ms(400), 0.7}]

    {:ok, knocks} =
      Situ.Test.run([level: level], fn streams ->
        Situ.via(streams.level, Knocks, threshold: 0.6, quiet: Time.ms(200))
      end)

    assert knocks == [{Time.ms(100), 0.9}, {Time.ms(400), 0.7}]
  end

  @tag :tmp_dir
  test "finds the knocks of the recorded sensor", %{tmp_dir: folder} do
    options = [input: Path.expand("../data/knocks.csv", __DIR__), recordings: folder]
    ExUnit.CaptureIO.capture_io(fn -> {:ok, _report} = Situ.Pipeline.run({{Module}}, options) end)

    {:ok, store} = Store.open(Path.join(folder, "{{app}}"))
    assert [0.91, 0.83, 0.78] == for(knock <- Store.messages(store, "Knock"), do: knock.data)
  end
end
