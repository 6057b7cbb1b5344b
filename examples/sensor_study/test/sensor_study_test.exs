defmodule SensorStudyTest do
  use ExUnit.Case, async: true
  alias SensorStudy.Swings
  alias Situ.Annotation.{Layer, Recording}
  alias Situ.Dataset
  alias Situ.Dataset.{OpenSession, SessionLayers}

  @legs ["lower", "upper"]

  setup context do
    {:ok, dataset} =
      Dataset.new("Walk", file: Path.join(context.tmp_dir, "study.json"), autosave: true)

    dataset =
      for leg <- @legs, reduce: dataset do
        dataset ->
          # Results are written next to the recordings, so the test works on copies.
          path = Path.join(context.tmp_dir, "#{leg}_leg.csv")
          File.cp!(Path.expand("../data/#{leg}_leg.csv", __DIR__), path)
          {:ok, dataset} = Dataset.add_session(dataset, leg)
          {:ok, dataset} = Dataset.add_partition(dataset, leg, "Sensor", path)
          dataset
      end

    {:ok, dataset, report} = Dataset.derive(dataset, Swings)
    assert Enum.all?(report.results, &(&1.status == :done))
    %{dataset: dataset}
  end

  @tag :tmp_dir
  test "both sensors see the same twenty strides of the walk", %{dataset: dataset} do
    for result <- SensorStudy.strides(dataset) do
      assert result.count == 19
      # Half a minute of walking with 95 steps a minute.
      assert_in_delta result.mean, 1.29, 0.02
      assert result.deviation < 0.15
    end

    agreement = SensorStudy.agreement(dataset, "lower", "upper")
    assert %{paired: 20, only_first: 0, only_second: 0} = agreement
    # The upper leg begins to swing before the lower leg follows.
    assert_in_delta agreement.begin_error, Situ.Time.ms(150), Situ.Time.ms(50)
  end

  @tag :tmp_dir
  test "a correction of a person counts instead of the proposal", %{dataset: dataset} do
    {:ok, dataset} = SessionLayers.copy_layer(dataset, "lower", "Gait", "Gait.Ada")
    {:ok, path} = SessionLayers.store_path(dataset, "lower")
    {:ok, layer} = Recording.load_layer(Situ.Store.open!(path), "Gait.Ada")
    [stumble | _] = Layer.annotations(layer)
    {:ok, layer, _} = Layer.remove(layer, [stumble.id])
    {:ok, _} = Recording.write(layer, path, "Gait.Ada")

    {:ok, dataset} = Dataset.open(dataset.file)
    assert [%{session: "lower", count: 18}, %{count: 19}] = SensorStudy.strides(dataset)
    {:ok, session} = Dataset.session(dataset, "lower")
    assert length(SessionLayers.list_layers(OpenSession.open(session))) == 2
  end
end
