"""Run by the tools' Python: `datasets` opens the folder of pairs, TRL's DPO trainer learns a step from it."""

import copy
import json
import sys
from pathlib import Path

from tokenizers import Tokenizer, models, pre_tokenizers
from transformers import GPT2Config, GPT2LMHeadModel, PreTrainedTokenizerFast
from trl import DPOConfig, DPOTrainer

import datasets

opened = datasets.load_dataset(sys.argv[1], cache_dir="cache")
letters = sorted({letter for split in opened.values() for row in split for letter in row["prompt"] + row["chosen"]})
words = {word: number for number, word in enumerate(["<pad>", "<end>", "?", *letters])}
alphabet = Tokenizer(models.WordLevel(words, unk_token="?"))
alphabet.pre_tokenizer = pre_tokenizers.Split("", "isolated")  # a token per letter: nothing is downloaded
tokenizer = PreTrainedTokenizerFast(tokenizer_object=alphabet, pad_token="<pad>", eos_token="<end>", unk_token="?")
size = {"n_positions": 8192, "n_embd": 8, "n_layer": 1, "n_head": 1}
model = GPT2LMHeadModel(GPT2Config(vocab_size=len(words), bos_token_id=1, eos_token_id=1, **size))
config = DPOConfig(
    "out", max_steps=1, per_device_train_batch_size=1, max_length=None, report_to=[], use_cpu=True, bf16=False,
    disable_tqdm=True, save_strategy="no", gradient_checkpointing=False,
)  # fmt: skip
trainer = DPOTrainer(
    model, copy.deepcopy(model), args=config, train_dataset=opened["train"], processing_class=tokenizer
)
result = trainer.train()
told = {
    "splits": {name: {"rows": len(of), "columns": of.column_names} for name, of in opened.items()},
    "rows": len(trainer.train_dataset),
    "decoded": "".join(tokenizer.convert_ids_to_tokens(trainer.train_dataset[0]["chosen_ids"])),
    "first": {name: opened["train"][0][name] for name in ("prompt", "chosen", "rejected")},
    "loss": result.training_loss,
    "trained_on": trainer.train_dataset.column_names,
}
Path("told.json").write_text(json.dumps(told))
