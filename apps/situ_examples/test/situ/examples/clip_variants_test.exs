defmodule Situ.Examples.ClipVariantsTest do
  use ExUnit.Case, async: true
  alias Situ.Dataset
  alias Situ.Dataset.OpenSession
  alias Situ.Examples.{ClipVariants, WhoSpeaksExperiment}

  @moduletag :tmp_dir
  # Ten sessions take 40 s on idle cores.
  @moduletag timeout: 300_000
  @demo Path.expand("../../../priv/demo", __DIR__)

  setup_all do
    for app <- [:situ_media, :situ_dataset], do: {:ok, _} = Application.ensure_all_started(app)
    :ok
  end

  defp times(dataset, session, stream) do
    {:ok, session} = Dataset.session(dataset, session)
    {:ok, messages} = OpenSession.messages(OpenSession.open(session), stream)

    for m <- messages,
        a <- m.data,
        do: {a.track, Float.round(a.from / 1.0e9, 2), Float.round(a.to / 1.0e9, 2)}
  end

  test "variants have the truth that follows from their clip", %{tmp_dir: root} do
    clips =
      for name <- ~w(talk2 talk3),
          do: {Path.join(@demo, name <> ".mp4"), Path.join(@demo, name <> ".truth.json")}

    {:ok, dataset} = ClipVariants.create_dataset(clips, root)
    assert length(dataset.sessions) == 10
    assert Dataset.troubles(dataset) == []
    assert {:ok, %{sessions: sessions}} = Dataset.open(dataset.file)
    assert Enum.map(sessions, & &1.name) == Enum.map(dataset.sessions, & &1.name)

    speech = [{"1", 0.9, 2.8}, {"0", 4.43, 7.33}]

    for condition <- ~w(plain mirrored noisy voices),
        do: assert(times(dataset, "talk2-#{condition}", "Speaking.Truth") == speech)

    assert times(dataset, "talk2-dubbed", "Speaking.Truth") == []

    assert times(dataset, "talk2-plain", "Voice.Truth") == [
             {"voice", 0.9, 2.8},
             {"voice", 4.43, 7.33}
           ]

    # The other clip has voices from 0.75 s to 7.29 s and from 9.29 s, after the end of this one.
    assert times(dataset, "talk2-dubbed", "Voice.Truth") == [{"voice", 0.75, 7.29}]
    # There, they begin 1.5 s later.
    assert times(dataset, "talk2-voices", "Voice.Truth") == [{"voice", 0.9, 8.79}]

    boxes = fn session ->
      for face <- elem(Dataset.session(dataset, session), 1).metadata["faces"],
          do: hd(face["box"])
    end

    assert [a, b] = boxes.("talk2-plain")
    assert [c, d] = boxes.("talk2-mirrored")
    assert a < b and c > d
    assert_in_delta c, 1024 - 380.5, 0.01
  end

  test "the default parameters are one of the sets" do
    {:ok, sets} = Situ.Experiment.Parameters.list_sets(WhoSpeaksExperiment.parameters())
    assert Enum.any?(sets, &(&1.json == WhoSpeaksExperiment.default_parameters()))
  end
end
